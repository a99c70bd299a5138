"""Calling the command line within a test's own process."""

import contextlib
import io
import os
import traceback
from importlib import import_module

from roomeq.cli import main
from roomeq.core.limits import LIMITS


def call(argv: list[str]) -> tuple[int, str]:
    """Run the command line in this process: exit status and what it wrote to stderr; a traceback is status 99.

    The first word is a verb of `roomeq`, or the name of a script of `local` that makes a synthetic corpus.
    """
    said, bounds = io.StringIO(), {limit.variable: os.environ.get(limit.variable, "") for limit in LIMITS}
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = (import_module(argv[0]).main(argv[1:]) if argv and argv[0].startswith("make_synthetic_")
                      else main(argv))
        except SystemExit as stop:
            status = stop.code
        except BaseException:
            traceback.print_exc(file=said)
            status = 99
        finally:
            os.environ.update(bounds)
    return status, said.getvalue()
