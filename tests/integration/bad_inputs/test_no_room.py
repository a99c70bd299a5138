"""No space left, and no right to write: one line, earlier results intact, and a second call finishes."""

import os
import re
import resource
import shutil
import subprocess

import pytest
from running import call, snapshot

COMMANDS = {
    "read-measured": "read-measured folder out", "read-noises": "read-noises noises out",
    "characterise": "characterise measured out", "split-rirs": "split-rirs --sizes 4,1,1 rirs out",
    "fit-eq": "fit-eq --num-components 2 measured out", "compensate": "compensate measured eq out",
    "augment": "augment speech rirs out", "prepare-speech": "prepare-speech transcripts out",
    "export": "export huggingface segmented out",
}


def inputs(argv, worlds, root):
    for name in argv:
        if (worlds / name).is_dir():
            shutil.copytree(worlds / name, root / name)
    for path in (root / "transcripts").glob("?.wav"):  # so that there is something to convert
        shutil.copy(worlds / "folder/hall/hall_44k.wav", path)


@pytest.fixture
def largest_file():
    """Return a function that bounds what any file of this process may hold [bytes]."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("verb, size", [(verb, 60) for verb in COMMANDS] + [
    (verb, 3000) for verb in ("characterise", "fit-eq", "compensate", "augment", "export")])
def test_a_file_that_cannot_grow(verb, size, worlds, tmp_path, monkeypatch, largest_file):
    argv = COMMANDS[verb].split()
    inputs(argv, worlds, tmp_path)
    monkeypatch.chdir(tmp_path)
    before = snapshot(tmp_path)
    largest_file(size)
    status, said = call(argv)
    largest_file(resource.RLIM_INFINITY)
    assert status == 1 and said.count("\n") == 1
    assert re.fullmatch(r"roomeq: (out|\.out)[^:]*: File too large: free some space, or choose another output\n", said)
    after = {name: content for name, content in snapshot(tmp_path).items() if name != "out" or content is not None}
    assert after == before
    assert call(argv)[0] == 0
    assert not [path for path in tmp_path.rglob("*.tmp")]


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 KiB; it can be made read-only."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk],
                                      capture_output=True).returncode:
        pytest.skip("needs to be root and allowed to mount")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_a_full_disk(worlds, small_disk, monkeypatch):
    monkeypatch.chdir(worlds)
    out = small_disk / "out"
    assert call(["read-noises", "noises", str(out)])[0] == 0
    before = snapshot(out)
    for argv in (["augment", "speech", "rirs", f"{small_disk}/speech"],
                 ["compensate", "measured", "eq", f"{small_disk}/eq"],
                 ["read-measured", "--noises", "noises", "folder", f"{small_disk}/rirs"]):
        (small_disk / "ballast").write_bytes(bytes(40 << 10))
        status, said = call(argv)
        assert status == 1 and said.count("\n") == 1
        assert "No space left on device: free some space, or choose another output" in said and str(small_disk) in said
        assert snapshot(out) == before
        assert {name for name in os.listdir(small_disk) if not name.startswith(".")} == {"out", "ballast"}
        for path in small_disk.glob(".*.part-*"):
            shutil.rmtree(path)


def test_a_read_only_place(worlds, small_disk, monkeypatch):
    monkeypatch.chdir(worlds)
    assert call(["read-noises", "noises", f"{small_disk}/out"])[0] == 0
    before = snapshot(small_disk)
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    for argv in (["read-noises", "--skip-bad", "noises", f"{small_disk}/out"],
                 ["characterise", "measured", f"{small_disk}/new/out"],
                 ["split-rirs", "--sizes", "4,1,1", "rirs", f"{small_disk}/split"]):
        status, said = call(argv)
        assert status == 1 and said.count("\n") == 1
        assert said.endswith(": Read-only file system: check the permissions\n") and f"roomeq: {small_disk}" in said
        assert snapshot(small_disk) == before
