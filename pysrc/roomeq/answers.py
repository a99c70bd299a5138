"""One process that tells a recipe which outputs are up to date: most of each answer's time would be Python's start.

``python -m roomeq.answers`` reads questions from stdin, one a line: the arguments of ``roomeq --ask``, separated by the
control character US (0x1f). It writes the exit status of each to the file descriptor 3, and ends with its input.
``utils/ask.sh`` is the other end.
"""

import io
import os
import signal
import sys
from typing import TextIO

from roomeq.cli import NOT_UP_TO_DATE, main
from roomeq.core.digests import code_digest

SEPARATOR = "\x1f"
ANSWERS = 3
"""File descriptor of the answers; what a verb prints goes to stdout and stderr."""


def answer(questions: TextIO, answers: TextIO) -> None:
    """Answer questions until there are no more; a verb whose output is to be made says nothing."""
    streams, said = (sys.stdout, sys.stderr), (io.StringIO(), io.StringIO())
    for question in questions:
        code_digest.cache_clear()  # the sources may change while the recipe runs
        sys.stdout, sys.stderr = said
        try:
            status = main(["--ask", *question.rstrip("\n").split(SEPARATOR)])
        finally:
            sys.stdout, sys.stderr = streams
        for stream, buffer in zip(streams, said, strict=True):
            if status != NOT_UP_TO_DATE:
                stream.write(buffer.getvalue())
                stream.flush()
            buffer.seek(0)
            buffer.truncate()
        answers.write(f"{status}\n")
        answers.flush()


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGPIPE):  # it ends with the recipe, and says nothing about it
        signal.signal(number, signal.SIG_DFL)
    answer(sys.stdin, os.fdopen(ANSWERS, "w"))
