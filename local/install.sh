#!/usr/bin/env bash
# Install the pinned Python packages into .venv, if that has not been done; needs no root.
# Usage: local/install.sh [requirements.txt ...]
# e.g.:  local/install.sh requirements.txt tests/requirements.txt
set -euo pipefail
. ./path.sh
[ $# -gt 0 ] || set -- requirements.txt
python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  { echo "install.sh: $(python3 --version) is too old: Python 3.11 or newer is needed" >&2 && exit 1; }
[ "$(uname -s)" = Linux ] || echo "install.sh: tested on Linux only; continuing" >&2

mark=.venv/.installed-$(cat pyproject.toml "$@" | sha256sum | cut -c1-16)
[ ! -f "$mark" ] || exit 0
mkdir -p .venv
exec 9>.venv/.lock # two runs may start at the same time
flock 9
[ ! -f "$mark" ] || exit 0
echo "install.sh: installing Python packages into .venv (about a minute, first run only)"
if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then # absent, or incomplete after a killed run
  python3 -m venv .venv || {
    rm -rf .venv
    echo "install.sh: python3 -m venv failed: on Debian and Ubuntu 'apt install python3-venv' provides it" >&2
    exit 1
  }
fi
requirements=()
for file; do requirements+=(-r "$file"); done
.venv/bin/python -m pip install --quiet --disable-pip-version-check "${requirements[@]}"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
touch "$mark"
