"""What the key of the loop distinguishes."""

import shutil

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
