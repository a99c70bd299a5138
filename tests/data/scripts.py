"""Running shell scripts as a user would, with a small script to run."""

import os
import subprocess

SCRIPT = """#!/usr/bin/env bash
# Say what the options are.
# Usage: say.sh [options] <word>
set -euo pipefail
nj=2         # jobs
some_name=   # a name
fast=false   # or true
. utils/parse_options.sh
[ $# -eq 1 ] || usage
require "$1" steps/before.sh
printf '%s|' "$nj" "$some_name" "$fast" "$1"
"""


def call(directory, *args):
    return subprocess.run(args, cwd=directory, capture_output=True, text=True,
                          env={"PATH": os.environ["PATH"]}, timeout=60)
