"""Small right inputs of every kind, for cases to break: {name of a directory: what makes it}.

Made once a session, with the folder they are made in as the current one, so that paths in them are relative.
"""

import json
from pathlib import Path

import numpy as np
from corpora_examples import make_folder, make_reverbdb, make_slr28, make_sofa, make_table, put, put_librispeech
from datadirs import FS, burst, rir_dir, speech_dir
from rirmaker import coloured_rir, row, write_rir_dir
from wer_run import put_example

from roomeq.core.audio import write_flac
from roomeq.core.build import DONE_FILE, Build
from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import write_json, write_jsonl, write_text
from roomeq.eq.gmm import FREE
from roomeq.kaldi.wavscp import flac_entry
from roomeq.kaldi.write import OutUtterance, write_data_dir

BOX = """v 0 0 0
v 5 0 0
v 5 4 0
v 0 4 0
v 0 0 3
v 5 0 3
v 5 4 3
v 0 4 3
usemtl brick_bare
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


def _measured(path: Path) -> None:
    """RIRs with geometry that analysis and simulation can work on."""
    places = [dict(source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[4.0, y_m, 1.2]) for y_m in (3.0, 3.5)]
    write_rir_dir(path, [(row(f"r{n}", f"hall{n % 2}", **places[n // 2]), coloured_rir(n)) for n in range(4)],
                  [dict(id="hum", room_id="hall0")])


def _mesh(path: Path) -> None:
    write_text(path / "room.obj", BOX)
    write_rir_dir(path, [(row("m1", mesh="room.obj", room_dims_m=None, source_pos_m=[1.0, 1.0, 1.5],
                              mic_pos_m=[4.0, 3.0, 1.2]), coloured_rir(0))])


def _eq(path: Path) -> None:
    weights, size = [0.6, 0.4], len(FREE)
    write_json(path / "gmm.json", dict(
        weights=weights, means_db=[[0.0] * size] * 2, covariances_db2=[np.eye(size).tolist()] * 2,
        points_hz=[BANDS_HZ[k] for k in FREE], weights_of_room=dict(hall0=weights, hall1=weights)))


def _segmented(path: Path) -> None:
    """A data directory with `segments`."""
    write_flac(path / "r.flac", burst(np.random.default_rng(0), 3 * FS))
    write_data_dir(path, dict(r=(flac_entry(str(path / "r.flac")), 3 * FS)), [
        OutUtterance("s-1", "s", "r", 0, FS, text="A"), OutUtterance("s-2", "s", "r", FS, 2 * FS, text="B")])


def _noises(path: Path) -> None:
    for name in ("roomtone", "click"):
        put(path / f"{name}.wav", np.linspace(-0.1, 0.1, 1600))
    write_text(path / "manifest.csv", "file,id,room,kind\nroomtone.wav,tone,hall0,ambient\nclick.wav,click,,point\n")


def _transcripts(path: Path) -> None:
    """Speech with a CSV: three speakers."""
    lines = []
    for speaker in "abc":
        put(path / f"{speaker}.wav", np.full(1600, 0.1))
        lines.append(f"{speaker}.wav,{speaker},WORDS\n")
    write_text(path / "manifest.csv", "file,speaker,transcript\n" + "".join(lines))


def _librispeech(path: Path) -> None:
    put_librispeech(path, {"train-clean-100": {"1": {"10": 2}}, "dev-clean": {"2": {"20": 2}},
                           "test-clean": {"3": {"30": 2}}})


def _made(path: Path) -> None:
    """A directory that a step of ours made: it has a stamp."""
    build = Build(path, step="fit-eq", options={}, inputs=[])
    build.run({}, lambda name, item: None)
    build.finish(lambda directory, _: write_jsonl(directory / "measured.jsonl", [dict(id="a")]))


def _decoded(path: Path) -> None:
    """Two Kaldi workspaces whose systems were scored, and the RIRs of their sets."""
    put_example(path, seeds=2)


WORLDS = dict(rirs=rir_dir, measured=_measured, mesh=_mesh, eq=_eq, speech=speech_dir, segmented=_segmented,
              noises=_noises, transcripts=_transcripts, librispeech=_librispeech, made=_made, reverbdb=make_reverbdb,
              table=make_table, folder=make_folder, slr28=make_slr28, sofa=make_sofa, decoded=_decoded)


def put_earlier(path: Path, step: str) -> None:
    """An earlier result of a step, with other options than any case asks for."""
    write_text(path / "result.txt", "weeks of work\n")
    write_text(path / DONE_FILE, json.dumps(dict(step=step, options={}, key="0" * 64, files={"result.txt": [14, "x"]})))
