"""Names and values that others chose are data: nothing is evaluated, nothing unpickled, nothing written elsewhere."""

import ast
import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from cases_rooms import many_times
from datadirs import FS, burst, rir_dir
from running import call, snapshot
from wrong import HOSTILE
from wrong import row as change_row

from roomeq.augment import augment
from roomeq.kaldi import validate_data_dir
from roomeq.kaldi.datadir import read_data_dir
from roomeq.kaldi.wavscp import flac_entry
from roomeq.kaldi.write import OutUtterance, write_data_dir
from roomeq.records.rir_dir import read_noises, read_rirs, rir_path, validate_rirs
from roomeq.records.schema import is_id

PACKAGE = Path(__file__).resolve().parents[3] / "pysrc" / "roomeq"
NAMES = ["two words", "it's", '"quoted"', "$(touch evil)", "`touch evil`", "a;touch evil", "-rf", "--help", "a..", "*",
         "é", "日本", "%s", "{0}", "a\\b", "tab\there", "x|y", "#x", "~", "JOB"]

TEXTURED = """ply
format ascii 1.0
comment TextureFile fifo
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


def files_outside(root, *inside):
    """Return the files below a folder that are in none of some folders, locks apart."""
    return {name for name in snapshot(root) if not name.startswith(tuple(inside))}


def test_a_corpus_of_hostile_names(worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    corpus = Path(HOSTILE)
    for n, name in enumerate([*NAMES, "line\nbreak", HOSTILE]):
        name += f" {n}" * name.isascii()
        (corpus / name).mkdir(parents=True)
        shutil.copy(worlds / f"measured/audio/r{n % 4}.wav", corpus / name / f"{name}.wav")
    before = snapshot(tmp_path)
    out = f"o {HOSTILE}"
    assert call(["read-measured", str(corpus), out])[0] == 0
    rows = read_rirs(out)
    assert len(rows) == len(NAMES) + 2 and all(is_id(row[key]) for row in rows for key in ("id", "room_id"))
    assert validate_rirs(out) == len(rows)
    for line, row in zip((Path(out) / "rir_list").read_text().splitlines(), rows, strict=True):
        command = shlex.split(line)[4]
        assert shlex.split(command)[2] == str(rir_path(out, row)), "a shell sees another file"
    assert call(["characterise", out, f"p {HOSTILE}"])[0] == 0
    assert snapshot(tmp_path).items() >= before.items()
    assert files_outside(tmp_path, HOSTILE, out, f"p {HOSTILE}") == set()


def test_speech_of_hostile_ids(tmp_path, monkeypatch):
    """Ids of a Kaldi directory may hold anything but blanks; they become file names only when they may."""
    monkeypatch.chdir(tmp_path)
    ids = sorted(name.replace(" ", "_").replace("\t", "_") + f"-{n}" for n, name in
                 enumerate([*NAMES, "../../up", "/root", ".hidden", HOSTILE, "a" * 300]))
    recordings, utterances = {}, []
    for n, key in enumerate(ids):
        path = Path("clean") / f"{n}.flac"
        path.parent.mkdir(exist_ok=True)
        soundfile.write(path, burst(np.random.default_rng(n), 4000), FS)
        recordings[key] = (flac_entry(path), 4000)
        utterances.append(OutUtterance(key, key, key, 0, 4000, text=f"{HOSTILE} {key}"))
    write_data_dir(Path("clean"), recordings, utterances, segmented=False)
    rir_dir(tmp_path / "rirs")
    for packing in ("recording", "utterance"):
        augment(Path("clean"), Path("rirs"), Path(f"out.{packing}"), packing=packing)
        assert validate_data_dir(Path(f"out.{packing}")) == len(ids)
        assert list(read_data_dir(Path(f"out.{packing}")).utterances) == ids
    assert files_outside(tmp_path, "clean", "rirs", "out.recording", "out.utterance") == set()


def test_steps_pass_hostile_paths_through(worlds, tmp_path, project_dir):
    """A step of the recipe, its jobs and their logs, with names that a shell would act on."""
    for name in ("path.sh", "cmd.sh", "utils", "steps", "pysrc", ".venv"):
        (tmp_path / name).symlink_to(project_dir / name)
    source, out = f"in {HOSTILE}", f"out {HOSTILE}"
    shutil.copytree(worlds / "measured", tmp_path / source)
    before = os.listdir(tmp_path)
    done = subprocess.run(["steps/characterise_rirs.sh", "--nj", "2", source, out], cwd=tmp_path, timeout=300,
                          capture_output=True, text=True, env=os.environ | {"cmd": "utils/local.sh"})
    assert done.returncode == 0, done.stderr
    assert len(read_rirs(tmp_path / out)) == 4 and len(read_noises(tmp_path / out)) == 1
    assert {name for name in os.listdir(tmp_path) if not name.startswith(".")} - set(before) == {out, "log"}


@pytest.mark.parametrize("module", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_is_evaluated_or_unpickled(module):
    """No pickle, no eval; a shell runs only what --pipes allows; arrays of objects are not loaded."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
            assert not names & {"pickle", "marshal", "shelve", "dill", "cloudpickle"}
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in ("eval", "exec", "compile", "os.system", "os.popen", "joblib.load", "np.load",
                                  "yaml.load"), f"line {node.lineno}"
            shell = [word for word in node.keywords if word.arg in ("shell", "allow_pickle")]
            assert not shell or (module.name == "wavscp.py" and called == "subprocess.run"), f"line {node.lineno}"


def test_terminal_sequences_and_line_breaks_are_escaped(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("\x1b]0;owned\x07", "a\nroomeq: OK", "\u202eabc", "a\r", "\ud800"):
        status, said = call(["validate", name])
        assert status == 1 and said.count("\n") == 1 and said[:-1].isprintable() and said.startswith("roomeq: ")


def test_a_folder_that_links_to_itself_ends(worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds / "folder", tmp_path / "corpus")
    for n in range(3):
        (tmp_path / "corpus" / f"loop{n}").symlink_to("..")
        (tmp_path / "corpus" / "hall" / f"loop{n}").symlink_to("..")
    assert call(["read-measured", "corpus", "out"])[0] == 0
    assert len(read_rirs("out")) == 4


def test_a_fifo_or_device_is_not_waited_for(worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds / "measured", tmp_path / "measured")
    row = json.loads((tmp_path / "measured/rirs.jsonl").read_text().splitlines()[0])
    os.mkfifo(tmp_path / "fifo")
    for wav in ("../fifo", "/dev/zero", "/dev/stdin"):
        (tmp_path / "measured/rirs.jsonl").write_text(json.dumps(row | {"wav": wav}) + "\n")
        status, said = call(["characterise", "measured", "out"])
        assert (status, said.count("no such audio file")) == (1, 1)


@pytest.mark.parametrize("name", ["wav.scp", "utt2spk"])
def test_a_fifo_in_a_data_directory_is_not_waited_for(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    rir_dir(tmp_path / "rirs")
    soundfile.write("a.wav", burst(np.random.default_rng(0), 4000), FS)
    os.mkdir("clean")
    for table, value in (("wav.scp", "a.wav"), ("utt2spk", "a")):
        Path("clean", table).write_text(f"a {value}\n")
    Path("clean", name).unlink()
    os.mkfifo(f"clean/{name}")
    status, said = call(["augment", "clean", "rirs", "out"])
    assert status == 1 and said.count("\n") == 1 and said.startswith(f"roomeq: clean/{name}: no such file: ")


def test_what_a_mesh_refers_to_is_not_waited_for(worlds, tmp_path, monkeypatch):
    """Buffers are regular files; textures are never opened."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds / "mesh", "mesh")
    os.mkfifo("mesh/fifo")
    right = many_times(1, 1)
    meshes = {"buffer.gltf": json.dumps(right | dict(buffers=[dict(uri="fifo", byteLength=42)])),
              "image.gltf": json.dumps(right | dict(images=[dict(uri="fifo")], textures=[dict(source=0)])),
              "texture.ply": TEXTURED}
    said = {}
    for name, content in meshes.items():
        Path("mesh", name).write_text(content)
        change_row("mesh/rirs.jsonl", 1, mesh=name)(tmp_path)
        status, said[name] = call(["simulate", "mesh", "out"])
        assert status == 1 and said[name].count("\n") == 1
    assert "uri='fifo' must name a regular file beside it" in said["buffer.gltf"]
    assert "the mesh has holes" in said["image.gltf"] and "the mesh has holes" in said["texture.ply"]
