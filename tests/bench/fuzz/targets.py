"""The parsers that `run.py` fuzzes, each in a process of its own: ``targets.py NAME WORK [libFuzzer options]``.

A target takes bytes and a work directory; it may raise `ValueError` only. While it runs, nothing outside that directory
may be opened for writing and no command may be started.
"""

import os
import sys
from pathlib import Path

SEPARATOR = b"\n%%\n"
"""Between the files of a directory in one input."""

_MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl felt\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
_ROW = b'{"id": "a", "wav": "a.wav", "room_id": "r", "source_id": "s", "mic_id": "m", "fs_hz": 16000, "n_samples": 9}\n'
_NOISE = b'{"id": "n", "wav": "n.wav", "kind": "ambient", "room_id": null, "duration_s": 1.5, "fs_hz": 16000}\n'
_CSV = (b"file,id,room,room_dims_m,source_pos_m,distance_m,binaural,kind,transcript,gender\n"
        b'a.wav,a,r,"1 2 ?",1 1 1,2.5,0,point,HI,m\n')
_META = (b"########\n$EnvDepth\t10.776\n$EnvMicID\t1\n$EnvMic1Depth\t1.7\n$EnvMic1Width\t4\n"
         b"$EnvMic1Height\t1 m\n$EnvTemp\t22 C\n")
_DIR = (b"a-1 a\na-2 a\n", b"a-1 x.wav\na-2 flac -c -d -s y.flac |\n", b"a-1 HI\na-2 HO\n", b"a a-1 a-2\n", b"a m\n",
        b"a-1 1.5\na-2 2.5\n", b"")
_TOML = b'[materials.felt]\nuse = ["wall", "floor", "ceiling"]\nabsorption = [0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]\n'
_WORDS = (  # what random bytes would not hit upon
    '"acoustic_parameters": {"eq_db": [', '"eq_valid": [true', '"eq_edge_db": null',
    '"direct_sample": ', '"room_dims_m": [',
    '"mesh": "', '"noise_for": "', '"weights_of_room": {', '"points_hz": [', "1e999", "NaN", "-1", "1e-320",
    "\\\\ud800", "null", "true", "$(touch evil)", "../", "\\x00", "\\xff", "\\xe2\\x80\\xa8", "flac -c -d -s ",
    " |", "--rir-id 1 ", "--room-id ", "uniform ", "normal ", "list ", "none", "usemtl ", "f 1 2 3 4", "v 1e300 ",
    "[scattering]", "use = [", "%%", "$EnvSpk1Depth", "99999999999999999999", "?", "source_dir", "mic_pos_m",
    "tof_removed", "documented_t60_s", "#0", "<s>", '"effect": "room_modes"', '"up_to_hz": ', '"gains_db": [',
    '"levels_db": [', '"cannot_tell": ["', '"test": {')
_MODEL = (b'{"format": 3, "effects": [{"effect": "near_reflector", "of": {"r": {"depth_m": 0.7, "reflection": 0.6}}, '
          b'"typical": [-0.4, 0.6], "spread": [0.1, 0.1]}, {"effect": "sound_speed", "of": {"all": '
          b'{"temperature_c": 20}}}]}')
_ERRORS = (b'{"leave_positions_out": {"error": 1.5, "ci": [1, 2], "by_metric": {"t30": 1.5}, "by_band": '
           b'[null, 1, 1, 1, 1, 1, 1, 1]}, "leave_room_out": {"error": 1.5, "ci": null, "by_metric": {}, "by_band": '
           b'[1, 1, 1, 1, 1, 1, 1, 1]}}')
_SHARES = (b'{"share": 0.5, "ci": null, "by_metric": {"t30": {"share": 1, "ci": [0, 2]}}, "by_band": ['
           + b", ".join([b'{"share": null, "ci": null}'] * 8) + b'], "at_ceiling": []}')
_LEDGER = (b'{"format": 9, "given": [], "rirs": 8, "rooms": 4, "scored_rirs": 8, "scored_rooms": 4, "left_out": [], '
           b'"geometry": [], "facings": [], "baseline": ' + _ERRORS + b', "iterations": [], "ranking": [{"effect": '
           b'"room_eq", "gain": 1, "ci": [0, 2], "p": 0.5, "size_jnd": 1, "rejected": {"reason": "no clear fall", '
           b'"rendered": false, "p": 0.5, "p_by_split": {"leave_positions_out": 0.5, "leave_room_out": 0.5}, '
           b'"touched_fall": {"leave_positions_out": 0, "leave_room_out": 0}, "p_other_devices": null}, '
           b'"detectable_jnd": null, "would_show": ""}], "unexplained": null, "unexplained_all": [], "final": '
           + _ERRORS + b', "ceiling": ' + _ERRORS + b', "explained": {"leave_positions_out": ' + _SHARES
           + b', "leave_room_out": ' + _SHARES + b"}}")
_WER = (b"a-1 one two\na-2 three\n", b"a-1 one\na-2\n", b"Set1: %WER 12.50 95% Conf Interval [ 10.1, 14.9 ]\n",
        b'{"rows": ["train.sim.rvb"], "columns": ["tg"], "seeds": [1], "test": "t", "sets": {"t": {"utterances": 2, '
        b'"words": 3, "rooms": 1}}, "dev_of": {"train.sim.rvb": "d"}, "rooms": [{"room": "r", "words": 3, "acoustics": '
        b'{"T20 at 1 kHz [s]": 0.5, "DRR [dB]": -3, "C50 at 1 kHz [dB]": 2, "EQ distance [dB]": null}, "wer": {"tg": '
        b'{"train.sim.rvb": 5}}}], "strata": [], "gains": [], "kaldi": ["5.5"], '
        b'"results": {"train.sim.rvb": {"tg": {"dev": {"wer": 1, "interval": [0, 2]}, "test": '
        b'{"wer": 5, "interval": null}, "dev_test_gap": {"points": 4, "interval": null, "p": null}}}}}')
_LIST = b"--rir-id 1 --room-id r 'RIRS_NOISES/a_rir_b.wav'\n"


def rows(data: bytes, work: Path) -> None:
    from roomeq.records.rir_dir import read_noises, read_rirs

    for name, read in (("rirs.jsonl", read_rirs), ("noises.jsonl", read_noises)):
        (work / name).write_bytes(data)
        refused(read, work)


def mixture(data: bytes, work: Path) -> None:
    import numpy as np

    from roomeq.eq.gmm import read_gmm, sample_eq

    (work / "gmm.json").write_bytes(data)
    sample_eq(read_gmm(work), 2, np.random.default_rng(0))


def csv(data: bytes, work: Path) -> None:
    from roomeq.corpora.table import list_noise_table, list_table
    from roomeq.corpora.transcripts import list_transcripts
    from roomeq.records.schema import row_problem

    (work / "manifest.csv").write_bytes(data)
    for read in (list_noise_table, list_transcripts):
        refused(read, work / "manifest.csv")
    for recording in list_table(work / "manifest.csv").rirs:
        problem = row_problem(recording.row | dict(id=recording.id, wav="x", fs_hz=1, n_samples=1))
        assert problem is None, problem


def meta(data: bytes, work: Path) -> None:
    from roomeq.corpora.reverbdb import list_reverbdb
    from roomeq.records.schema import row_problem

    mic = work / "room" / "MicID01" / "SpkID01_20190503_S" / "01"
    if not mic.is_dir():
        (mic / "RIR").mkdir(parents=True)
        (mic / "RIR" / "a.wav").touch()
    (mic / "mic_meta.txt").write_bytes(data)
    for recording in list_reverbdb(work).rirs:
        problem = row_problem(recording.row | dict(id=recording.id, wav="x", fs_hz=1, n_samples=1))
        assert problem is None, problem


def data_dir(data: bytes, work: Path) -> None:
    from roomeq.corpora.kaldi_dir import read_kaldi_dir
    from roomeq.kaldi import validate_data_dir

    names = ("utt2spk", "wav.scp", "text", "spk2utt", "spk2gender", "utt2dur", "segments")
    for name, content in zip(names, data.split(SEPARATOR), strict=False):
        (work / name).write_bytes(content)
    for name in names[data.count(SEPARATOR) + 1:]:
        (work / name).unlink(missing_ok=True)
    refused(read_kaldi_dir, work)
    validate_data_dir(work, audio=False)


def wav_scp(data: bytes, work: Path) -> None:
    from roomeq.kaldi.wavscp import flac_entry, parse_entry

    text = data.decode(errors="surrogateescape")
    refused(parse_entry, text)
    if text == text.strip() and text:
        assert parse_entry(flac_entry(text)).text in (text, f"./{text}")


def slr28(data: bytes, work: Path) -> None:
    from roomeq.corpora.slr28 import list_slr28, room_of

    real = work / "RIRS_NOISES" / "real_rirs_isotropic_noises"
    real.mkdir(parents=True, exist_ok=True)
    (real / "rir_list").write_bytes(data)
    (real / "noise_list").write_bytes(data)
    room_of(data.decode(errors="replace")[:255])
    list_slr28(work)


def librispeech(data: bytes, work: Path) -> None:
    from roomeq.corpora.librispeech import list_librispeech

    chapter = work / "dev" / "1" / "2"
    if not chapter.is_dir():
        chapter.mkdir(parents=True)
        (chapter / "1-2-0000.flac").touch()
    trans, _, speakers = data.partition(SEPARATOR)
    (chapter / "1-2.trans.txt").write_bytes(trans)
    (work / "SPEAKERS.TXT").write_bytes(speakers)
    list_librispeech([work / "dev"])


def materials(data: bytes, work: Path) -> None:
    from roomeq.sim.materials import read_materials

    (work / "own.toml").write_bytes(data)
    read_materials(work / "own.toml")


def mesh(data: bytes, work: Path) -> None:
    from roomeq.sim.mesh import make_room
    from roomeq.sim.meshfile import read_triangles

    (work / "room.obj").write_bytes(data)
    make_room(*read_triangles(work / "room.obj"))


def options(data: bytes, work: Path) -> None:
    import click

    from roomeq import cli
    from roomeq.augment.distribution import parse_distribution
    from roomeq.core.build import share

    words = data.decode(errors="surrogateescape").split("\n")
    for parse in (lambda text: parse_distribution(text, "snr_db"), lambda text: share(["a", "b"], text)):
        refused(parse, words[0])
    shown = cli.printable(words[0])
    assert shown.isprintable() and len(shown) < 2 * cli.MAX_MESSAGE
    for command in (cli.cli, *cli.cli.commands.values()):
        try:
            command.make_context(command.name, list(words))
        except (click.UsageError, click.exceptions.Exit):
            pass


def stamp(data: bytes, work: Path) -> None:
    from roomeq.core.stamps import read_stamp
    from roomeq.validate import check_stamp

    (work / ".done").write_bytes(data)
    read_stamp(work)
    check_stamp(work)


def model(data: bytes, work: Path) -> None:
    import numpy as np

    from roomeq.effects.model import read_model

    (work / "model.json").write_bytes(data)
    for one in read_model(work / "model.json").for_row(dict(id="a", room_id="r", source_id="s", mic_id="m"), 0):
        assert np.isfinite(one.vector()).all()


def ledger(data: bytes, work: Path) -> None:
    from roomeq.loop.ledger import read_ledger

    (work / "ledger.json").write_bytes(data)
    read_ledger(work / "ledger.json")


def wer(data: bytes, work: Path) -> None:
    from roomeq.wer.check import read_wer
    from roomeq.wer.scoring import read_bootci, read_hypotheses, read_reference

    (work / "scoring_kaldi").mkdir(exist_ok=True)
    names = ("scoring_kaldi/test_filt.txt", "scoring_kaldi/7.txt", "bootci", "wer.json")
    contents = [*data.split(SEPARATOR), *[b""] * len(names)]
    for name, content in zip(names, contents, strict=False):
        (work / name).write_bytes(content)
    refused(read_bootci, work)
    refused(read_wer, work / "wer.json")
    read_hypotheses(work / "scoring_kaldi/7.txt", read_reference(work))


def refused(read, argument) -> None:
    """Call one of several readers; a refusal is no reason to leave out the next."""
    try:
        read(argument)
    except ValueError:
        pass


TARGETS = {
    "rows": (rows, [_ROW + _NOISE, _NOISE, _ROW.replace(
        b'"n_samples"', b'"acoustic_parameters": {"eq_db": [0]}, "n_samples"')]),
    "mixture": (mixture, [b'{"weights": [1.0], "means_db": [[0,0,0,0,0,0,0]], "covariances_db2": [[[1]]]}', b"[]"]),
    "csv": (csv, [_CSV, b"file;room\na.wav;b\n", b'file\n"a\nb.wav"\n']),
    "meta": (meta, [_META]),
    "data_dir": (data_dir, [SEPARATOR.join(_DIR), SEPARATOR.join([*_DIR[:1], b"r x.wav\n", *_DIR[2:6],
                                                                  b"a-1 r 0 1.5\na-2 r 1.5 -1\n"])]),
    "wav_scp": (wav_scp, [b"a.wav", b"x.ark:12", b"flac -c -d -s 'a b.flac' |", b"sox a.wav -t wav - |",
                          b"a.ark:1[0:2]"]),
    "slr28": (slr28, [_LIST, b"air_type1_air_binaural_lecture_1_2"]),
    "librispeech": (librispeech, [b"1-2-0000 SOME WORDS\n" + SEPARATOR + b"1 | M | dev | 8.0 | |CBW|Simon\n"]),
    "materials": (materials, [_TOML, _TOML + b"[scattering]\nrough = 0.5\n"]),
    "mesh": (mesh, [_MESH, _MESH.replace(b"f 1 3 2", b"f 1/1/1 -2 2//3")]),
    "options": (options, [b"uniform 5 25\n", b"simulate\n--num-rays\n3\na\nb", b"2/5\n",
                          b"--max-mesh-mb\n1\nvalidate\nx"]),
    "model": (model, [_MODEL]),
    "ledger": (ledger, [_LEDGER, _LEDGER.replace(b'"iterations": []', b'"iterations": [{"effect": "room_eq"}]')]),
    "wer": (wer, [SEPARATOR.join(_WER)]),
    "stamp": (stamp, [b'{"step": "a", "key": "b", "files": {"x": [1, "y"]}, "options": {}}']),
}


def _forbid(work: Path) -> None:
    """Make the process fail when something outside the work directory is written, or a command is started."""
    inside = str(work)

    def watch(event, args):
        if event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect",
                     "pickle.find_class"):
            os.write(2, f"ForbiddenError: {event} {args}\n".encode())
            os.abort()
        if event == "open" and isinstance(args[0], str) and args[2] & (os.O_WRONLY | os.O_RDWR):
            if not os.path.abspath(args[0]).startswith(inside) and args[0] != os.devnull:
                os.write(2, f"ForbiddenError: writes {args[0]}\n".encode())
                os.abort()

    sys.addaudithook(watch)


def main() -> None:
    """Fuzz one target, as `run.py` asks."""
    import atheris

    name, work = sys.argv[1], Path(sys.argv[2]).resolve()
    target, seeds = TARGETS[name]
    (work / "corpus").mkdir(exist_ok=True)
    for n, seed in enumerate(seeds):
        (work / "corpus" / str(n)).write_bytes(seed)
    quoted = (word.replace('"', '\\"') for word in _WORDS)
    (work / "words").write_text("".join(f'"{word}"\n' for word in quoted))
    box = work / "box"
    box.mkdir(exist_ok=True)
    import logging
    import warnings

    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")
    with atheris.instrument_imports(include=["roomeq", "csv", "shlex", "tomllib"], enable_loader_override=False):
        refused(lambda data: target(data, box), seeds[0])  # imports what it needs

    def one(data: bytes) -> None:
        refused(lambda data: target(data, box), data)

    sys.stdout = sys.stderr = open(os.devnull, "w") if name == "options" else sys.stderr
    os.chdir(box)
    _forbid(work)
    atheris.Setup([sys.argv[0], *sys.argv[3:]], one)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "pysrc"))
    main()
