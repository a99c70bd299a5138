"""What the key of the loop distinguishes, and on how many threads it computes."""

import shutil

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from roomeq.core.workers import share_out
from roomeq.loop import close
from roomeq.loop.step import close_loop


def test_key_tells_train_from_test_and_from_a_model(tmp_path, monkeypatch):
    monkeypatch.setattr(close, "make", lambda build, *_: dict(key=build.key))
    monkeypatch.chdir(tmp_path)
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "notes.txt").write_text(name)
    shutil.copy("a/notes.txt", "model.json")
    keys = {close_loop(rir_dirs, "out", test=test, model=model)["key"] for rir_dirs, test, model in (
        (["a", "b"], [], None), (["a"], ["b"], None), (["a", "model.json"], [], None), (["a"], ["model.json"], None),
        (["a"], [], "model.json"))}
    assert len(keys) == 5


def test_loop_and_its_workers_compute_on_one_thread(monkeypatch):
    """Of a pool of several: sums over them differ in their last bits."""
    counts = []

    def blas_threads(_=None):
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    def count(*_):
        counts.extend([blas_threads(), *share_out(blas_threads, range(3), 2, label="count threads")])
        raise ValueError("counted")

    monkeypatch.setattr(close, "require_enough_rooms", count)
    with threadpool_limits(2), pytest.raises(ValueError, match="counted"):
        close.make(None, [], [], None, max_effects=1, seed=0, nj=2)
    assert len(counts) == 4 and {number for process in counts for number in process} == {1}
