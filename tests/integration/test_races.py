"""Several runs in one directory at once, and a disk that fills up: the same bytes in the end, or an error."""

import multiprocessing
import os
import random
import subprocess
import time

import numpy as np
import pytest

from roomeq.core.audio import write_flac, write_wav
from roomeq.core.build import Build
from roomeq.core.files import read_json, write_json, write_jsonl

PROCESSES = multiprocessing.get_context("fork")


def make(out, version=1, part=None, naps=None):
    """Make a directory of sounds in twelve items; `naps` (a seed) lets it take random moments over them."""
    build = Build(out, step="race", options=dict(version=version), inputs=[])
    nap = random.Random(naps)

    def one(name, number):
        rng = np.random.default_rng([version, number])
        if naps is not None:
            time.sleep(nap.uniform(0, 0.02))
        write_wav(build.work / f"wav/{name}.wav", rng.standard_normal(500))
        write_flac(build.work / f"{name}.flac", rng.uniform(-0.5, 0.5, 3000))
        write_jsonl(build.work / f"{name}.jsonl", [dict(number=number)] * 50)
        return number

    def assemble(directory, records):
        write_json(directory / "all.json", records)

    if not build.done and build.run({f"n{n}": n for n in range(12)}, one, part=part):
        build.finish(assemble)


def contents(directory):
    return {str(path.relative_to(directory)): path.read_bytes()
            for path in sorted(directory.rglob("*")) if path.is_file() and path.name != ".done"}


def started(*args, **how):
    process = PROCESSES.Process(target=make, args=args, kwargs=how)
    process.start()
    return process


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    out = tmp_path_factory.mktemp("expected") / "out"
    make(out)
    return contents(out)


@pytest.mark.parametrize("seed", range(5))
def test_runs_at_once_make_one_whole_directory(seed, expected, tmp_path):
    out, parts = tmp_path / "out", [None, "1/2", None, "2/2", None, None]
    processes = [started(out, part=part, naps=100 * seed + n) for n, part in enumerate(parts)]
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * len(parts)
    assert contents(out) == expected
    assert sorted(path.name for path in tmp_path.iterdir()) == [".out.lock", "out"]


@pytest.mark.parametrize("seed", range(5))
def test_runs_that_want_different_things_leave_one_of_them_whole(seed, expected, tmp_path):
    """The one that comes too late refuses; in the end there is a whole directory, and it is what its stamp says."""
    out = tmp_path / "out"
    processes = [started(out, version=version, naps=100 * seed + version) for version in (1, 2)]
    for process in processes:
        process.join()
    assert sum(process.exitcode == 0 for process in processes) >= 1
    version = read_json(out / ".done")["options"]["version"]
    make(tmp_path / "again", version=version)
    assert contents(out) == contents(tmp_path / "again")
    make(out)
    assert contents(out) == expected


@pytest.fixture
def disk(tmp_path):
    """A function that gives a small disk of so many KiB, or changes its size."""
    if os.geteuid() != 0:
        pytest.skip("needs root, to mount a small file system")
    place = tmp_path / "disk"
    place.mkdir()

    def sized(kib, *more):
        mounted = os.path.ismount(place)
        options = ",".join([*["remount"] * mounted, f"size={kib}k", *more])
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "small", place], capture_output=True, check=False)
        if done.returncode:
            pytest.skip(f"cannot mount a small file system here: {done.stderr.decode().strip()}")
        return place

    yield sized
    subprocess.run(["umount", place], check=False)


def test_a_file_is_whole_or_absent_however_full_the_disk_is(disk, tmp_path):
    samples = np.random.default_rng(0).uniform(-0.5, 0.5, 30000)
    writers = {"a.wav": write_wav, "a.flac": write_flac,
               "a.jsonl": lambda path, samples: write_jsonl(path, [dict(value=float(x)) for x in samples[:2000]])}
    for name, write in writers.items():
        write(tmp_path / name, samples)
    place, failed = disk(1000), 0
    for free_kib in range(0, 140, 4):
        for name, write in writers.items():
            with open(place / "ballast", "wb") as stream:
                stream.write(bytes(1024 * (1000 - free_kib)))
            try:
                write(place / name, samples)
                assert (place / name).read_bytes() == (tmp_path / name).read_bytes()
            except OSError:
                failed += 1
                assert sorted(path.name for path in place.iterdir()) == ["ballast"]
            for path in place.iterdir():
                path.unlink()
    assert 30 < failed < 100


def test_a_full_disk_loses_nothing(disk, expected):
    place, failed = disk(1000), 0
    for kib in range(20, 240, 20):
        disk(kib)
        out = place / str(kib) / "out"
        try:
            make(out)
        except OSError as error:
            failed += 1
            assert "No space left" in str(error)
            assert not out.exists()
        disk(4000)
        make(out)
        assert contents(out) == expected
        subprocess.run(["rm", "-rf", place / str(kib)], check=True)
    assert failed >= 4


def test_a_disk_that_cannot_be_written_is_an_error_and_what_is_done_stays_done(disk, expected):
    place = disk(4000)
    make(place / "out")
    disk(4000, "ro")
    make(place / "out")
    with pytest.raises(OSError, match="Read-only file system"):
        make(place / "out", version=2)
    disk(4000, "rw")
    assert contents(place / "out") == expected
