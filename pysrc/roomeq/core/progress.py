"""Progress of long work and its remaining time: a line that is rewritten on a terminal, a line a minute in a log.

Work may be nested (the RIRs of a candidate, of all candidates): the line counts the outermost and names the inner one.
Processes that share the work of another stay silent. A job that runs elsewhere writes its progress to a file besides,
which the script that started it shows (``utils/progress.sh``).
"""

import logging
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TextIO, TypeVar

logger = logging.getLogger(__name__)

SHOWN_AFTER_S = 2.0
"""Work that takes less time is not shown."""

LOG_EVERY_S = 60.0
REDRAWN_EVERY_S = 0.5
FILE_EVERY_S = 1.0
FOLDER_VARIABLE = "ROOMEQ_PROGRESS"
"""Environment variable with the folder for the progress of jobs."""

_LINE = "\r\033[K"
"""Return to the start of the terminal's line and clear it."""

Item = TypeVar("Item")

_stack: list["Meter"] = []
_silenced_in = 0  # process id of a worker
_logged_s: float | None = None  # when the last line was logged, of whatever work, or the first began


def silence() -> None:
    """Let this process show no progress: it works for another one that does."""
    global _silenced_in
    _silenced_in = os.getpid()


class Meter:
    """Counts finished items of some work, and shows the count; a context manager.

    Parameters
    ----------
    total : int
        Number of items.
    label : str
        Name of the work, e.g. ``"simulate rirs.sim.train"``.
    """

    def __init__(self, total: int, label: str) -> None:
        self.total, self.label, self.done = total, label, 0
        global _logged_s
        self._start = self._drawn = self._filed = time.monotonic()
        self._is_drawn = False
        _logged_s = self._start if _logged_s is None else _logged_s

    def __enter__(self) -> "Meter":
        if self.total > 1:  # a single item is either not begun or done
            _stack.append(self)
        if _stack == [self] and FOLDER_VARIABLE in os.environ and _silenced_in != os.getpid():
            self._write(Path(os.environ[FOLDER_VARIABLE]), self._start)
        return self

    def __exit__(self, *_: object) -> None:
        if self in _stack:
            _stack.remove(self)
        if self._is_drawn:
            sys.stderr.write(_LINE)
            sys.stderr.flush()

    def advance(self, count: int = 1) -> None:
        """Count one more item, or several."""
        self.done += count
        tick()

    def left_s(self, now: float) -> float | None:
        """Return the remaining time, as all items take the same time [s]; None before the first item is done."""
        return (now - self._start) * (self.total - self.done) / self.done if self.done else None

    def text(self, now: float) -> str:
        """Return the state in a line, e.g. ``simulate: 12 of 40, 1 min 10 s left``."""
        left_s = self.left_s(now)
        return f"{self.label}: {self.done} of {self.total}" + ("" if left_s is None else f", {duration(left_s)} left")

    def show(self) -> None:
        """Draw, log or file the state of all current work where it is time to."""
        global _logged_s
        now = time.monotonic()
        if now - self._start < SHOWN_AFTER_S:
            return
        if FOLDER_VARIABLE in os.environ and now - self._filed >= FILE_EVERY_S:
            self._filed = now
            self._write(Path(os.environ[FOLDER_VARIABLE]), now)
        if sys.stderr.isatty():
            if now - self._drawn >= REDRAWN_EVERY_S:
                self._drawn, self._is_drawn = now, True
                sys.stderr.write(_LINE + self._line(now)[:terminal_columns() - 1])
                sys.stderr.flush()
        elif _logged_s is not None and now - _logged_s >= LOG_EVERY_S:
            _logged_s = now
            logger.info("%s", self._line(now))

    def _line(self, now: float) -> str:
        return self.text(now) + self._inner()

    def _inner(self) -> str:
        """Return the state of the innermost work within this one, if there is any."""
        inner = _stack[-1]
        return "" if inner is self else f" ({inner.label} {inner.done} of {inner.total})"

    def _write(self, folder: Path, now: float) -> None:
        """Write the state for ``utils/progress.sh``: items done, of all, seconds left (-1: unknown), the label."""
        left_s = self.left_s(now)
        name = f"{os.uname().nodename}.{os.getpid()}"
        try:
            (folder / f".{name}").write_text(f"{self.done} {self.total} {-1 if left_s is None else round(left_s)} "
                                             f"{self.label}{self._inner()}\n", encoding="utf-8", errors="replace")
            (folder / f".{name}").replace(folder / name)
        except OSError:  # nobody looks at it any longer
            os.environ.pop(FOLDER_VARIABLE)


def tick() -> None:
    """Show the current work where it is time to; call it while waiting."""
    if _stack and _silenced_in != os.getpid():
        _stack[0].show()


def progress(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """Yield the items of an iterable and show how many are done.

    Parameters
    ----------
    items : iterable
    total : int
        Number of items.
    label : str
        Name of the work, e.g. ``"simulate"``.
    """
    with Meter(total, label) as meter:
        for item in items:
            yield item
            meter.advance()


def duration(seconds: float) -> str:
    """Return a duration in its two largest units, e.g. ``1 min 10 s``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    return f"{whole // 60} min {whole % 60} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60} min"


def terminal_columns() -> int:
    """Return the width of the terminal that the progress is drawn on."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or 80
    except (OSError, ValueError):
        return 80


class LineHandler(logging.StreamHandler[TextIO]):
    """Writes messages to stderr and clears the line of the progress before each."""

    def __init__(self) -> None:
        super().__init__(sys.stderr)

    def emit(self, record: logging.LogRecord) -> None:
        if any(meter._is_drawn for meter in _stack):
            self.stream.write(_LINE)
        super().emit(record)
