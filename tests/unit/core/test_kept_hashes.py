"""A kept hash is that of the file's present content, whatever was done to its size, times or name."""

import os
import threading

import pytest

from roomeq.core import kept_hashes
from roomeq.core.files import hash_file
from roomeq.core.kept_hashes import hashes_of_input


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Three files whose hashes are kept from run to run."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept_hashes, "KEPT_FROM_BYTES", 0)
    monkeypatch.setattr(kept_hashes, "SETTLED_NS", 0)
    paths = [tmp_path / f"{n}.wav" for n in range(3)]
    for path in paths:
        path.write_text(f"content of {path.name}")
    return paths


def in_place(path):
    path.write_text(path.read_text().upper())


def in_place_at_the_same_time(path):
    before = path.stat()
    in_place(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def by_another_file(path):
    other = path.with_suffix(".new")
    other.write_text(path.read_text().upper())
    before = path.stat()
    os.utime(other, ns=(before.st_atime_ns, before.st_mtime_ns))
    os.replace(other, path)


@pytest.mark.parametrize("change", [in_place, in_place_at_the_same_time, by_another_file])
def test_changed_content_is_noticed_behind_equal_size_and_time(change, files):
    before = hashes_of_input("corpus", files)
    assert before == [hash_file(path) for path in files]
    change(files[1])
    after = hashes_of_input("corpus", files)
    assert after == [hash_file(path) for path in files]
    assert [old != new for old, new in zip(before, after, strict=True)] == [False, True, False]


def test_unchanged_files_are_not_read_again(files, monkeypatch):
    before = hashes_of_input("corpus", files)
    monkeypatch.setattr(kept_hashes, "hash_file", lambda path: pytest.fail(f"{path} was read"))
    assert hashes_of_input("corpus", files) == before


def test_fresh_file_is_read_again(files, monkeypatch):
    monkeypatch.setattr(kept_hashes, "SETTLED_NS", 2_000_000_000)
    read, hash_of = [], kept_hashes.hash_file
    monkeypatch.setattr(kept_hashes, "hash_file", lambda path: read.append(path) or hash_of(path))
    hashes_of_input("corpus", files)
    hashes_of_input("corpus", files)
    assert len(read) == 2 * len(files)


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"a": 1}', '{"a": [[1, 2], 3]}', "\0\0\0"])
def test_damaged_store_is_done_without(content, files, tmp_path):
    before = hashes_of_input("corpus", files)
    (store,) = (tmp_path / "cache/roomeq/hashes").glob("*.json")
    store.write_text(content)
    assert hashes_of_input("corpus", files) == before


def test_hash_that_changed_in_the_store_is_not_used(files, tmp_path):
    before = hashes_of_input("corpus", files)
    (store,) = (tmp_path / "cache/roomeq/hashes").glob("*.json")
    store.write_text(store.read_text().replace(before[0], before[0][::-1]))
    assert hashes_of_input("corpus", files) == before


def test_store_that_cannot_be_written_is_done_without(files, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no directory")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert hashes_of_input("corpus", files) == [hash_file(path) for path in files]


def test_user_without_a_home_has_no_store(files, monkeypatch):
    for name in ("XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 2**31 - 7)  # in no list of users
    assert hashes_of_input("corpus", files) == [hash_file(path) for path in files]
    assert hashes_of_input("corpus", files) == [hash_file(path) for path in files]


def test_absent_files_and_pipes_have_no_hash(files, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    found = []
    thread = threading.Thread(daemon=True, target=lambda: found.append(
        hashes_of_input("corpus", [tmp_path / "absent", tmp_path / "pipe", tmp_path])))
    thread.start()
    thread.join(20)
    assert found == [[None, None, None]]
