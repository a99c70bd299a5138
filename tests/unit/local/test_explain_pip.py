"""Failures of pip are explained by their cause, in one line."""

import pytest

from explain_pip import explanation

RETRY = ("WARNING: Retrying (Retry(total=0, connect=None)) after connection broken by 'NewConnectionError(\"Failed to "
         "establish a new connection: [Errno 111] Connection refused\")': /numpy/\n")
NONE = """ERROR: Could not find a version that satisfies the requirement numpy==2.4.6 (from versions: none)
ERROR: No matching distribution found for numpy==2.4.6
"""
SOME = """ERROR: Could not find a version that satisfies the requirement numpy==2.4.6 (from versions: 1.26.4, 2.0.0)
ERROR: No matching distribution found for numpy==2.4.6
"""
HASHES = """ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE. If you have updated the package
versions, please update the hashes. Otherwise, examine the package contents carefully; someone may have tampered.
    numpy==2.4.6 from file:///mirror/numpy-2.4.6-cp311-cp311-linux_x86_64.whl (from -r requirements.txt (line 3)):
        Expected sha256 00
             Got        11
"""


@pytest.mark.parametrize("log, reason", [
    (RETRY + NONE, "pip reaches no index that has numpy==2.4.6: connect"),
    (NONE, "pip reaches no index that has numpy==2.4.6: connect"),
    (SOME, "there is no numpy==2.4.6 for this Python and machine"),
    (HASHES, "numpy is not the file that the requirements pin by hash"),
    ("Downloading\nERROR: Could not install packages due to an OSError: [Errno 28] No space left on device\n\n",
     "the disk is full"),
    (RETRY + "OSError: [Errno 122] Disk quota exceeded\n", "the disk is full"),
    ("ERROR: Could not install packages due to an OSError: [Errno 13] Permission denied: '/a/b'\n",
     "Permission denied: '/a/b'"),
    ("The virtual environment was not created successfully because ensurepip is not\navailable.  On Debian/Ubuntu "
     "systems, you need to install the python3-venv\n", "apt install python3-venv"),
    ("pip._vendor.urllib3.exceptions.ReadTimeoutError: HTTPSConnectionPool: Read timed out.\n",
     "connect to the network"),
    ("Traceback (most recent call last):\n  File ...\nKeyError: 'x'\n", "KeyError: 'x'"),
    ("Collecting numpy\nERROR: something new\n[notice] a new release\n", "ERROR: something new"),
    ("", "it was ended without a word"),
])
def test_cause_is_named(log, reason):
    assert reason in explanation(log) and "\n" not in explanation(log)
