"""Broken rows of `rirs.jsonl` and `noises.jsonl`, broken `gmm.json`, and broken stamps."""

from wrong import Case, keys, line, remove, reorder, row, write

RIRS = "measured/rirs.jsonl"
NOISES = "rirs/noises.jsonl"
CHARACTERISE = "characterise measured out"
SIMULATE = "simulate --num-rays 100 measured out"
FIT = "fit-eq --num-components 2 measured out"
COMPENSATE = "compensate measured eq out"
AUGMENT = "augment speech rirs out"


def rows(name: str, command: str, message: str, **changed) -> Case:
    """Return a case whose second row has changed values."""
    return Case(name, command, message, (row(RIRS, 2, **changed),))


CASES = [
    Case("rows missing", CHARACTERISE,
         "measured/rirs.jsonl: no such file: check the path, or run the step that makes it (of recordings: roomeq "
         "read-measured)", (remove(RIRS),)),
    Case("rows empty", CHARACTERISE, "measured/rirs.jsonl: no RIRs in it: run the step that makes it again",
         (write(RIRS, ""),)),
    Case("rows no json", CHARACTERISE,
         "measured/rirs.jsonl:3: not JSON (...): correct the line or make the file again", (line(RIRS, 3, "id=r2"),)),
    Case("row cut off", CHARACTERISE,
         "measured/rirs.jsonl:4: not JSON (...): correct the line or make the file again",
         (line(RIRS, 4, '{"id": "r3", "wav": "au'),)),
    Case("row a list", CHARACTERISE,
         "measured/rirs.jsonl:1: '[1, 2]' must be a JSON object: correct the line or make the file again",
         (line(RIRS, 1, "[1, 2]"),)),
    Case("rows not utf-8", CHARACTERISE,
         "measured/rirs.jsonl:1: not JSON (...): correct the line or make the file again",
         (write(RIRS, b'{"id": "r\xff"}\n'),)),
    Case("rows with nan", CHARACTERISE,
         "measured/rirs.jsonl:2: not JSON (...): correct the line or make the file again",
         (row(RIRS, 2, distance_m=float("nan")),)),
    Case("rows with infinity", CHARACTERISE,
         "measured/rirs.jsonl:2: not JSON (...): correct the line or make the file again",
         (line(RIRS, 2, '{"id": "r1", "distance_m": 1e999}'),)),
    Case("rows nested deep", CHARACTERISE,
         "measured/rirs.jsonl:2: not JSON (...): correct the line or make the file again",
         (line(RIRS, 2, '{"id": ' + "[" * 100000),)),
    Case("rows with a number of 5000 digits", CHARACTERISE,
         "measured/rirs.jsonl:2: not JSON (...): correct the line or make the file again",
         (line(RIRS, 2, '{"id": ' + "1" * 5000 + "}"),)),
    Case("row without wav", CHARACTERISE,
         "measured/rirs.jsonl:2: key 'wav' is missing: correct the line or make the file again",
         (row(RIRS, 2, _without="wav"),)),
    Case("rows unsorted", CHARACTERISE,
         "measured/rirs.jsonl:2: id 'r2' must sort after 'r3' (duplicate or unsorted): correct the line or "
         "make the file again", (reorder(RIRS, lambda lines: lines[::-1]),)),
    Case("rows duplicate", CHARACTERISE,
         "measured/rirs.jsonl:2: id 'r0' must sort after 'r0' (duplicate or unsorted): correct the line or "
         "make the file again", (reorder(RIRS, lambda lines: lines[:1] + lines),)),
    rows("id a path", CHARACTERISE,
         "measured/rirs.jsonl:2: id='../../evil' must be 1 to 200 letters, digits or ._+-, no dash or dot "
         "first, no path: correct the line or make the file again", id="../../evil"),
    rows("id with a blank", CHARACTERISE,
         "measured/rirs.jsonl:2: id='r 1' must be 1 to 200 letters, digits or ._+-, no dash or dot first, no "
         "path: correct the line or make the file again", id="r 1"),
    rows("id with a dash in front", CHARACTERISE,
         "measured/rirs.jsonl:2: id='-rf' must be 1 to 200 letters, digits or ._+-, no dash or dot first, no "
         "path: correct the line or make the file again", id="-rf"),
    rows("id evaluated", CHARACTERISE,
         "measured/rirs.jsonl:2: id='$(touch evil)' must be 1 to 200 letters, digits or ._+-, no dash or dot "
         "first, no path: correct the line or make the file again", id="$(touch evil)"),
    rows("id with a line break", CHARACTERISE,
         "measured/rirs.jsonl:2: id='r1\\nr2' must be 1 to 200 letters, digits or ._+-, no dash or dot first, "
         "no path: correct the line or make the file again", id="r1\nr2"),
    rows("id too long", CHARACTERISE,
         "measured/rirs.jsonl:2: id='rrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrrr... must be 1 "
         "to 200 letters, digits or ._+-, no dash or dot first, no path: correct the line or make the file "
         "again", id="r" * 300),
    rows("id a number", CHARACTERISE,
         "measured/rirs.jsonl:2: id=7 must be 1 to 200 letters, digits or ._+-, no dash or dot first, no path: "
         "correct the line or make the file again", id=7),
    rows("room a list", CHARACTERISE,
         "measured/rirs.jsonl:2: room_id=['a'] must be 1 to 200 letters, digits or ._+-, no dash or dot first, "
         "no path: correct the line or make the file again", room_id=["a"]),
    rows("wav a number", CHARACTERISE,
         "measured/rirs.jsonl:2: wav=3 must be a file name: correct the line or make the file again", wav=3),
    rows("wav with a line break", CHARACTERISE,
         "measured/rirs.jsonl:2: wav='audio/r1.wav\\nx' must be a file name: correct the line or make the file "
         "again", wav="audio/r1.wav\nx"),
    rows("wav with a zero byte", CHARACTERISE,
         "measured/rirs.jsonl:2: wav='audio/r1.wav\\x00' must be a file name: correct the line or make the "
         "file again", wav="audio/r1.wav\0"),
    rows("wav too long", CHARACTERISE, "measured/...: File name too long: shorten the name", wav="a" * 5000),
    rows("wav outside unicode", CHARACTERISE,
         "measured/rirs.jsonl:2: wav='audio/\\ud800.wav' must be a file name: correct the line or make the "
         "file again", wav="audio/\ud800.wav"),
    rows("rate a text", CHARACTERISE,
         "measured/rirs.jsonl:2: fs_hz='16000' must be a positive whole number: correct the line or make the "
         "file again", fs_hz="16000"),
    rows("rate negative", CHARACTERISE,
         "measured/rirs.jsonl:2: fs_hz=-16000 must be a positive whole number: correct the line or make the "
         "file again", fs_hz=-16000),
    rows("length zero", CHARACTERISE,
         "measured/rirs.jsonl:2: n_samples=0 must be a positive whole number: correct the line or make the "
         "file again", n_samples=0),
    rows("length a bool", CHARACTERISE,
         "measured/rirs.jsonl:2: n_samples=True must be a positive whole number: correct the line or make the "
         "file again", n_samples=True),
    rows("room of two numbers", SIMULATE,
         "measured/rirs.jsonl:2: room_dims_m=[5, 4] must be three numbers (each may be null): correct the line "
         "or make the file again", room_dims_m=[5, 4]),
    rows("room of a number of 400 digits", SIMULATE,
         "measured/rirs.jsonl:2: room_dims_m=[10000000000000000000000000000000000000000000000000000000000... "
         "must be three numbers (each may be null): correct the line or make the file again",
         room_dims_m=[10**400, 4, 3]),
    rows("room of texts", SIMULATE,
         "measured/rirs.jsonl:2: room_dims_m=['5', '4', '3'] must be three numbers (each may be null): correct "
         "the line or make the file again", room_dims_m=["5", "4", "3"]),
    rows("room flat", SIMULATE,
         "RIR r1: room_dims_m=[6.0, 5.0, 0.0] must be three lengths in [0.1, 200] m: correct the room",
         room_dims_m=[6, 5, 0]),
    rows("room of 10 km", SIMULATE,
         "RIR r1: room_dims_m=[10000.0, 5.0, 3.0] must be three lengths in [0.1, 200] m: correct the room",
         room_dims_m=[10000, 5, 3]),
    rows("source outside", SIMULATE,
         "RIR r1: source_pos_m[0]=7 must lie in [0.01, 5.99] m of a room of [6.0, 5.0, 3.0] m: correct it",
         source_pos_m=[7.0, 1.0, 1.5]),
    rows("source outside by far", SIMULATE,
         "measured/rirs.jsonl:2: source_pos_m=[1e+300, 1.0, 1.5] must be three numbers (each may be null): "
         "correct the line or make the file again", source_pos_m=[1e300, 1.0, 1.5]),
    rows("microphone outside", SIMULATE,
         "RIR r1: mic_pos_m[1]=-0.5 must lie in [0.01, 4.99] m of a room of [6.0, 5.0, 3.0] m: correct it",
         mic_pos_m=[1.0, -0.5, 1.5]),
    rows("on top of each other", SIMULATE,
         "RIR r1: source and microphone are 0 m apart and must be at least 0.05 m: correct the positions, or leave "
         "them out",
         mic_pos_m=[1.0, 1.0, 1.5]),
    rows("distance a text", SIMULATE,
         "measured/rirs.jsonl:2: distance_m='near' must be a number, not negative: correct the line or make "
         "the file again", distance_m="near", room_dims_m=None),
    rows("distance negative", SIMULATE,
         "measured/rirs.jsonl:2: distance_m=-3 must be a number, not negative: correct the line or make the "
         "file again", distance_m=-3, mic_pos_m=None),
    rows("distance of 5 km", SIMULATE,
         "RIR r1: distance_m=5000 between source and microphone has no place in the room: correct distance or "
         "room", distance_m=5000, mic_pos_m=None),
    rows("temperature a text", SIMULATE,
         "measured/rirs.jsonl:2: temperature_c='warm' must be a number: correct the line or make the file again",
         temperature_c="warm"),
    rows("temperature of the sun", SIMULATE,
         "...temperature_c=5800 must lie in [-20, 50] (ISO 9613-1): give degrees Celsius", temperature_c=5800),
    rows("humidity of 300", SIMULATE, "...humidity_pct=300 must lie in [0, 100]: give relative humidity in percent",
         humidity_pct=300),
    rows("mesh a number", SIMULATE,
         "measured/rirs.jsonl:2: mesh=5 must be a file name: correct the line or make the file again", mesh=5),
    rows("mesh absent", SIMULATE, "RIR r1: measured/../absent.obj: no such mesh file: check the path",
         mesh="../absent.obj"),
    rows("mesh a list", SIMULATE,
         "measured/rirs.jsonl:2: mesh=['a'] must be a file name: correct the line or make the file again",
         mesh=["a"]),
    rows("source direction of two", SIMULATE,
         "measured/rirs.jsonl:2: source_dir=[1, 0] must be a unit vector: three numbers in [-1, 1] (each "
         "may be null): correct the line or make the file again", source_dir=[1, 0]),
    rows("acoustic parameters a number", FIT,
         "measured/rirs.jsonl:2: acoustic_parameters=5 must be an object: correct the line or make the file "
         "again", acoustic_parameters=5),
    rows("acoustic parameters a list", FIT,
         "measured/rirs.jsonl:2: acoustic_parameters=['eq_db'] must be an object: correct the line or make "
         "the file again",
         acoustic_parameters=["eq_db"]),
    rows("acoustic parameters of seven points", FIT,
         "measured/rirs.jsonl:2: acoustic_parameters: eq_db=[0, 0, 0, 0, 0, 0, 0] must be 8 numbers: correct the "
         "line or make the file again", acoustic_parameters=dict(eq_db=[0] * 7, eq_valid=[True] * 7, eq_edge_db=None)),
    rows("acoustic parameters without edge", FIT,
         "measured/rirs.jsonl:2: acoustic_parameters: key 'eq_edge_db' is missing: correct the line or make "
         "the file again",
         acoustic_parameters=dict(eq_db=[0] * 8, eq_valid=[True] * 8)),
    rows("acoustic parameters of texts", FIT,
         "measured/rirs.jsonl:2: acoustic_parameters: eq_db=['0', '0', '0', '0', '0', '0', '0', '0'] must be 8 "
         "numbers: correct the line or make the file again",
         acoustic_parameters=dict(eq_db=["0"] * 8, eq_valid=[True] * 8, eq_edge_db=None)),
    rows("acoustic parameters null", "split-rirs measured out",
         "measured/rirs.jsonl:2: acoustic_parameters: eq_db=None must be 8 numbers: correct the line or make the "
         "file again", acoustic_parameters=dict(eq_db=None)),
    rows("direct sound a text", FIT,
         "measured/rirs.jsonl:2: direct_sample='early' must be a number of samples, not negative: correct the "
         "line or make the file again", direct_sample="early"),
    rows("direct sound behind the end", FIT,
         "measured/audio/r1.wav: direct_sample=1e+06 must lie before the response's end, 9920: find it again",
         direct_sample=10**6),
    rows("direct sound negative", COMPENSATE,
         "measured/rirs.jsonl:2: direct_sample=-4.5 must be a number of samples, not negative: correct the "
         "line or make the file again", direct_sample=-4.5, direct_polarity=1),
    rows("polarity of 7", COMPENSATE,
         "measured/rirs.jsonl:2: direct_polarity=7 must be 1 or -1: correct the line or make the file again",
         direct_sample=320, direct_polarity=7),
    Case("row with a key twice", COMPENSATE, "measured/rirs.jsonl:1: not JSON (key 'fs_hz' occurs twice: leave one "
         "out): correct the line or make the file again", (line(
             "measured/rirs.jsonl", 1, '{"fs_hz": 8000, "fs_hz": 16000}'),)),
    rows("model a number", COMPENSATE,
         "measured/rirs.jsonl:2: model=5 must be a list of effects: correct the line or make the file again",
         model=5),
    rows("noise for a list", COMPENSATE,
         "measured/rirs.jsonl:2: noise_for=['r0'] must be the id of an RIR: correct the line or make the file "
         "again", noise_for=["r0"]),
    rows("noise for nobody", COMPENSATE,
         "measured: noise_for='nobody' of RIR r1 is no RIR of this directory: simulate it again", noise_for="nobody"),
    rows("repeat of a list", CHARACTERISE,
         "measured/rirs.jsonl:2: repeat_of=['r0'] must be the id of an RIR: correct the line or make the file "
         "again", repeat_of=["r0"]),
    Case("target of 50 s", "simulate measured out",
         "measured: RIR r1: target_t60_s=50 must lie in [0.05, 10] s, or be null to keep the materials: correct "
         "the row",
         (row(RIRS, 2, target_t60_s=50),)),
    rows("binaural a text", CHARACTERISE,
         "measured/rirs.jsonl:2: binaural='no' must be true or false: correct the line or make the file again",
         binaural="no"),
    rows("excitation a number", CHARACTERISE,
         "measured/rirs.jsonl:2: excitation=3 must be a text: correct the line or make the file again", excitation=3),
    rows("screen a number", FIT,
         "measured/rirs.jsonl:2: screen=3 must be a text: correct the line or make the file again", screen=3),
    Case("seven components of four", "fit-eq measured out",
         "measured: 4 measured RIRs are left after screening of 4: must be at least 7, the mixture's "
         "components: give more, or fewer --num-components"),
    Case("all for noises", COMPENSATE,
         "measured: noise_for='r9' of RIR r0 is no RIR of this directory: simulate it again",
         tuple(row(RIRS, n, noise_for="r9") for n in (1, 2, 3, 4))),
    Case("one room split by room", "split-rirs --split-by room measured out",
         "measured: 4 RIRs of 2 rooms leave test empty when split by room: give more RIRs, or others with "
         "--dev-rirs and --test-rirs, or split by 'rir'"),
    Case("two rirs in three sets", "split-rirs measured out",
         "measured: 2 RIRs of 2 rooms leave test empty when split by rir: give more RIRs, or others with "
         "--dev-rirs and --test-rirs",
         (reorder(RIRS, lambda lines: lines[:2]),)),

    Case("noises no json", AUGMENT,
         "rirs/noises.jsonl:2: not JSON (...): correct the line or make the file again", (line(NOISES, 2, "hum"),)),
    Case("noise id a path", AUGMENT,
         "rirs/noises.jsonl:2: id='../hum' must be 1 to 200 letters, digits or ._+-, no dash or dot first, no "
         "path: correct the line or make the file again", (row(NOISES, 2, id="../hum"),)),
    Case("noise ids unsorted", "validate rirs",
         "rirs/noises.jsonl:2: id 'hum-room1' must sort after 'tap' (duplicate or unsorted): correct the line "
         "or make the file again", (reorder(NOISES, lambda lines: lines[::-1]),)),
    Case("noise kind", AUGMENT,
         "rirs/noises.jsonl:2: kind='loud' must be 'ambient' or 'point': correct the line or make the file "
         "again", (row(NOISES, 2, kind="loud"),)),
    Case("noise wav a list", AUGMENT,
         "rirs/noises.jsonl:2: wav=['a'] must be a file name: correct the line or make the file again",
         (row(NOISES, 2, wav=["a"]),)),
    Case("noise wav absent", AUGMENT, "rirs/wav/absent.flac: no such audio file: check the path",
         tuple(row(NOISES, n, wav="wav/absent.flac") for n in (1, 2, 3))),
    Case("noise room a list", AUGMENT,
         "rirs/noises.jsonl:2: room_id=['room1'] must be 1 to 200 letters, digits or ._+-, no dash or dot "
         "first, no path: correct the line or make the file again", (row(NOISES, 2, room_id=["room1"]),)),
    Case("noise id twice with other audio", "augment --noises more speech rirs out",
         "more/x.wav: noise id 'tap' is also that of rirs/wav/tap.flac: ids must be unique: rename one",
         (write("more/noises.jsonl", '{"id": "tap", "wav": "x.wav", "kind": "point"}\n'),)),
    Case("noises elsewhere empty", "augment --noises noises speech rirs out",
         "noises: no noises in it (noises.jsonl is missing): make it with 'roomeq read-noises'"),
    Case("all rirs for noises", AUGMENT,
         "rirs: all 6 RIRs are noise RIRs: one for speech is needed: give another directory",
         tuple(row("rirs/rirs.jsonl", n, noise_for="x") for n in range(1, 7))),
    Case("stated direct sound outside", AUGMENT,
         "direct_sample=4000 of RIR room0-0 must lie in its 4000 samples: characterise it again",
         tuple(row("rirs/rirs.jsonl", n, direct_sample=4000) for n in range(1, 7))),

    Case("mixture absent", COMPENSATE, "eq/gmm.json: no such mixture: run fit-eq first", (remove("eq/gmm.json"),)),
    Case("mixture no json", COMPENSATE, "eq/gmm.json: not a JSON file (...): make it again",
         (write("eq/gmm.json", "{weights: 1}"),)),
    Case("mixture a pickle", COMPENSATE, "eq/gmm.json:1: byte 0x80 is not UTF-8: convert the file",
         (write("eq/gmm.json", b"\x80\x04\x95cos\nmkdir\n(S'evil'\ntR."),)),
    Case("mixture a list", COMPENSATE, "eq/gmm.json: not a mixture of fit-eq (...): run fit-eq again",
         (write("eq/gmm.json", "[1, 2]"),)),
    Case("mixture without weights", COMPENSATE, "eq/gmm.json: not a mixture of fit-eq (...): run fit-eq again",
         (write("eq/gmm.json", "{}"),)),
    Case("mixture weight a number", COMPENSATE,
         "eq/gmm.json: weights (), means (2, 7), covariances (2, 7, 7) must be (k,), (k, 7), (k, 7, 7): run "
         "fit-eq again", (keys("eq/gmm.json", weights=1),)),
    Case("mixture weights of 2", COMPENSATE,
         "eq/gmm.json: weights must be 2 numbers from 0 that sum to 1: run fit-eq again",
         (keys("eq/gmm.json", weights=[1, 1]),)),
    Case("mixture weights of three", COMPENSATE,
         "eq/gmm.json: weights (3,), means (2, 7), covariances (2, 7, 7) must be (k,), (k, 7), (k, 7, 7): run "
         "fit-eq again", (keys("eq/gmm.json", weights=[0.4, 0.3, 0.3]),)),
    Case("mixture weight nan", COMPENSATE,
         "eq/gmm.json: not a JSON file (number NaN must be finite): make it again",
         (keys("eq/gmm.json", weights=[float("nan"), 1]),)),
    Case("mixture mean of texts", COMPENSATE, "eq/gmm.json: not a mixture of fit-eq (...): run fit-eq again",
         (keys("eq/gmm.json", means_db=[["a"] * 7] * 2),)),
    Case("mixture covariance negative", COMPENSATE,
         "eq/gmm.json: means must be below 200 dB and covariances positive definite: run fit-eq again",
         (keys("eq/gmm.json", covariances_db2=[[[-1.0 * (i == j) for i in range(7)] for j in range(7)]] * 2),)),
    Case("mixture of other points", COMPENSATE,
         "eq/gmm.json: points_hz=[1, 2, 3, 4, 5, 6, 7] must be [62.5, 125.0, 250.0, 500.0, 2000.0, 4000.0, "
         "8000.0]: run fit-eq again", (keys("eq/gmm.json", points_hz=[1, 2, 3, 4, 5, 6, 7]),)),
    Case("mixture rooms a list", COMPENSATE, "eq/gmm.json: not a mixture of fit-eq (...): run fit-eq again",
         (keys("eq/gmm.json", weights_of_room=[1]),)),
    Case("mixture room of three", COMPENSATE,
         "eq/gmm.json: weights of room hall0 must be 2 numbers from 0 that sum to 1: run fit-eq again",
         (keys("eq/gmm.json", weights_of_room=dict(hall0=[1, 0, 0])),)),
    Case("mixture room of texts", COMPENSATE, "eq/gmm.json: not a mixture of fit-eq (...): run fit-eq again",
         (keys("eq/gmm.json", weights_of_room=dict(hall0=["a", "b"])),)),
    Case("mixture of astronomical means", COMPENSATE,
         "eq/gmm.json: means must be below 200 dB and covariances positive definite: run fit-eq again",
         (keys("eq/gmm.json", means_db=[[1e300] * 7] * 2),)),

    Case("stamp no json", "report data exp out",
         "data/rirs.real/.done: is damaged: remove data/rirs.real and make it again",
         (write("data/rirs.real/.done", "{"),)),
    Case("stamp a list", CHARACTERISE,
         "measured/.done: is not a stamp of roomeq (step, key, files): remove measured and make it again",
         (write("measured/.done", "[]"),)),
    Case("stamp without files", CHARACTERISE,
         "measured/.done: is not a stamp of roomeq (step, key, files): remove measured and make it again",
         (write("measured/.done", '{"key": "x"}'),)),
    Case("stamp of an older format", "split-rirs --sizes 2,1,1 measured out",
         "measured: was written by an older roomeq (format 1, not 2): run roomeq characterise again",
         (write("measured/.done", '{"step": "characterise", "key": "x", "files": {}}'),)),
    Case("stamp of a newer format", "validate measured",
         "measured: was written by a newer roomeq (format 3, not 2): run roomeq split-rirs again",
         (write("measured/.done", '{"format": 3, "step": "split", "key": "x", "files": {}}'),)),
    Case("stamp of an older format beside noises", AUGMENT,
         "rirs: was written by an older roomeq (format 1, not 2): run roomeq read-measured again",
         (write("rirs/.done", '{"step": "read-measured", "key": "x", "files": {}}'),)),
    Case("stamp of the output no json", CHARACTERISE, "out/.done: is damaged: remove out and make it again",
         (write("out/.done", "{"),)),
    Case("stamp of texts", CHARACTERISE,
         "measured/.done: is not a stamp of roomeq (step, key, files): remove measured and make it again",
         (write("measured/.done", '{"files": {"rirs.jsonl": "x"}}'),)),
]
