"""Calling the command line within a test's own process."""

import contextlib
import io
import os
import traceback

from roomeq.cli import main
from roomeq.core.limits import LIMITS


def call(argv: list[str]) -> tuple[int, str]:
    """Run the command line in this process: exit status and what it wrote to stderr; a traceback is status 99."""
    said, bounds = io.StringIO(), {limit.variable: os.environ.get(limit.variable, "") for limit in LIMITS}
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = main(argv)
        except SystemExit as stop:
            status = stop.code
        except BaseException:
            traceback.print_exc(file=said)
            status = 99
        finally:
            os.environ.update(bounds)
    return status, said.getvalue()
