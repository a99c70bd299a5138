"""Devices with one name in several corpora are taken for one, and the log says so."""

import logging

import pytest
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.loop import close
from roomeq.loop.shared_devices import MOST_NAMED, warn_of_shared_devices
from roomeq.loop.step import close_loop

TAKEN_FOR_ONE = ("and taken for one device each; if they are others there, one response is fitted to several devices: "
                 "rename them in one of the corpora (if not, state one corpus)")


def device(corpus, source_id, mic_id):
    return row("r", corpus=corpus, source_id=source_id, mic_id=mic_id)


def warnings_of(caplog, *rows):
    warn_of_shared_devices(rows)
    return [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]


@pytest.mark.parametrize("rows", [
    [device("a", "s", "m"), device("a", "s", "m")], [device("a", "s", "m"), device("b", "t", "n")],
    [device(None, "s", "m"), device(None, "s", "m")], [device("a", "unknown", "unknown"), device("b", "unknown", "n")],
], ids=["one corpus", "other names", "no corpora", "unnamed"])
def test_devices_of_one_corpus_and_of_other_names_are_not_mentioned(caplog, rows):
    assert warnings_of(caplog, *rows) == []


def test_devices_of_several_corpora_are_named_once_for_the_same_corpora(caplog):
    assert warnings_of(caplog, device("b", "s", "m"), device("a", "s", "m"), device("a", "t", "n"),
                       device(None, "t", "o")) == [
        f"mic_id=m, source_id=s: in corpora a and b, {TAKEN_FOR_ONE}",
        f"source_id=t: in corpora a and rows without one, {TAKEN_FOR_ONE}"]


def test_many_devices_are_counted(caplog):
    text, = warnings_of(caplog, *(device(corpus, f"s{n:02}", f"m{n:02}") for corpus in "ab" for n in range(MOST_NAMED)))
    assert f"mic_id=m{MOST_NAMED - 1} and {MOST_NAMED} more: in corpora a and b" in text


def test_loop_warns_of_devices_that_the_test_set_shares(tmp_path, monkeypatch, caplog):
    def stop(*_, **__):
        raise InterruptedError

    def rir_dir(name, first):
        return write_rir_dir(tmp_path / name, [
            (row(f"r{first + n}", f"{name}{n // 2}", corpus=name, mic_id=f"m{first}", source_pos_m=[1.0, 1.0, 1.5],
                 mic_pos_m=[3.0 + n % 2, 3.0, 1.2]), coloured_rir(first + n)) for n in range(6)])
    monkeypatch.setattr(close, "load_data", stop)
    with pytest.raises(InterruptedError):
        close_loop([rir_dir("lab", 0)], tmp_path / "loop", test=[rir_dir("elsewhere", 6)])
    assert f"source_id=s: in corpora elsewhere and lab, {TAKEN_FOR_ONE}" in caplog.text
