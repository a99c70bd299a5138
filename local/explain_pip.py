#!/usr/bin/env python3
"""Say in one line why an installation of packages failed.

Usage: local/explain_pip.py <log of pip or venv>
"""

import re
import sys
from pathlib import Path

# the first that fits explains: a full disk or a refused file is also followed by other errors
REASONS = (
    (r"No space left on device|Disk quota exceeded",
     "the disk is full: .venv needs 1.2 GB, and the folder for temporary files ($TMPDIR or /tmp) 100 MB"),
    (r"Read-only file system|Permission denied", "a file cannot be written: {line}"),
    (r"DO NOT MATCH THE HASHES",
     "{package} is not the file that the requirements pin by hash: it was changed on its way or by a mirror; clear "
     "pip's cache (python3 -m pip cache purge) and check where pip downloads from (python3 -m pip config list)"),
    (r"ensurepip is not|No module named '?(?:ensurepip|venv)",
     "this Python has no venv: on Debian and Ubuntu, apt install python3-venv"),
    (r"from versions: none|Connection|Temporary failure in name resolution|[Tt]imed? ?out|Proxy|SSLError|CERTIFICATE",
     "pip reaches no index that has {package}: connect to the network, or name a mirror or proxy to pip "
     "(PIP_INDEX_URL, PIP_PROXY), or a folder of the files (PIP_NO_INDEX=1 PIP_FIND_LINKS=DIR)"),
    (r"No matching distribution", "where pip looks (python3 -m pip config list) there is no {package} for this Python "
     "and machine: use Python 3.11 to 3.14 on x86_64 or aarch64 with glibc, or a complete mirror"),
    (r"No module named '?pip", "pip was removed from .venv: remove .venv"),
)


def explanation(log: str) -> str:
    """Return the reason of a failure that left this log."""
    for pattern, reason in REASONS:
        found = re.search(pattern, log)
        if found:
            line = next(line for line in log.splitlines() if found[0] in line)
            return reason.format(line=line.strip(), package=package(log))
    errors = [line for line in log.splitlines() if re.match(r"error", line, re.I)] or log.splitlines()
    return errors[-1].strip() if errors else "it was ended without a word"


def package(log: str) -> str:
    """Return the package that an error is about."""
    named = re.search(r"No matching distribution found for ([^\s(]+)|DO NOT MATCH.*?\n +([^\s=]+)==", log, re.S)
    return (named[1] or named[2]) if named else "the package"


if __name__ == "__main__":
    print(explanation(Path(sys.argv[1]).read_text(encoding="utf-8", errors="replace")))
