"""Progress of work: what is shown where, and when."""

import io
import logging
import os
import subprocess
from pathlib import Path

import pytest

from roomeq.core import progress as module
from roomeq.core.progress import Meter, duration, progress, tick

SCRIPT = Path(__file__).resolve().parents[3] / "utils/progress.sh"


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on by a second with each item."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(module, "_logged_s", None)

    def work(n):
        for item in range(n):
            now[0] += 1.0
            yield item

    return work


def test_terminal_shows_counts_and_remaining_time_on_one_line(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(module.sys, "stderr", terminal)
    assert list(progress(clock(100), 100, "simulate")) == list(range(100))
    shown = terminal.getvalue()
    assert "simulate: 10 of 100, 1 min 30 s left" in shown and "\n" not in shown
    assert shown.endswith("\r\033[K")  # nothing remains


def test_log_has_a_line_a_minute(clock, caplog):
    caplog.set_level("INFO")
    list(progress(clock(200), 200, "simulate"))
    assert caplog.messages == [f"simulate: {n} of 200, {duration(200 - n)} left" for n in (60, 120, 180)]


def test_log_has_a_line_a_minute_over_several_works(clock, caplog):
    caplog.set_level("INFO")
    for name in "abcd":
        list(progress(clock(40), 40, name))
    assert caplog.messages == ["b: 20 of 40, 20 s left", "c: 40 of 40, 0 s left"]


@pytest.mark.parametrize("count", [0, 1])
def test_short_work_shows_nothing(count, clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(module.sys, "stderr", terminal)
    list(progress(clock(count), count, "simulate"))
    assert terminal.getvalue() == ""


def test_nested_work_counts_the_outer_and_names_the_inner(clock, caplog):
    caplog.set_level("INFO")
    for _ in progress(range(4), 4, "candidates"):
        list(progress(clock(50), 50, "render"))
    assert caplog.messages[0] == "candidates: 1 of 4, 3 min 0 s left (render 10 of 50)"


def test_workers_are_silent(clock, caplog, monkeypatch):
    caplog.set_level("INFO")
    monkeypatch.setattr(module, "_silenced_in", os.getpid())
    list(progress(clock(200), 200, "simulate"))
    assert caplog.messages == []


def test_error_ends_the_progress(clock):
    with pytest.raises(ValueError, match="broken"), Meter(3, "simulate"):
        raise ValueError("broken")
    assert module._stack == []
    tick()


def test_jobs_are_added_up_by_the_script(clock, tmp_path, monkeypatch):
    monkeypatch.setenv(module.FOLDER_VARIABLE, str(tmp_path))
    for job, n in enumerate((20, 30)):
        monkeypatch.setattr(module.os, "getpid", lambda job=job: job + 10)
        work = progress(clock(100), 100, "simulate rirs")
        for _ in range(n):
            next(work)
        work.close()
    text = subprocess.run(["bash", "-c", f". '{SCRIPT}'; progress_text '{tmp_path}'"], capture_output=True, text=True,
                          check=True).stdout
    assert text == "simulate rirs: 48 of 200, 1 min 21 s left\n"


def test_a_folder_that_is_gone_does_no_harm(clock, tmp_path, monkeypatch):
    monkeypatch.setenv(module.FOLDER_VARIABLE, str(tmp_path / "gone"))
    assert len(list(progress(clock(10), 10, "simulate"))) == 10
    assert module.FOLDER_VARIABLE not in os.environ


def test_messages_clear_the_line_of_the_progress(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(module.sys, "stderr", terminal)
    handler = module.LineHandler()
    for n in progress(clock(10), 10, "simulate"):
        if n == 5:
            handler.emit(logging.LogRecord("x", logging.INFO, "", 0, "a message", (), None))
    assert "\r\033[Ka message\n" in terminal.getvalue()


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "0 s"), (59, "59 s"), (70, "1 min 10 s"), (7320, "2 h 2 min")])
def test_durations_have_two_units(seconds, text):
    assert duration(seconds) == text


def test_script_without_jobs_yet_shows_nothing_and_goes_on(tmp_path):
    done = subprocess.run(["bash", "-euo", "pipefail", "-c",
                           f". '{SCRIPT}'; text=$(progress_text '{tmp_path}'); echo \"[$text]\""], capture_output=True,
                          text=True, check=True)
    assert done.stdout == "[]\n"
