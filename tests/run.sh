#!/usr/bin/env bash
# Check everything: installs what is missing into .venv, then linters, type checker, manual and tests.
# Usage: tests/run.sh [--install-only] [pytest arguments]
# e.g.:  tests/run.sh                              # the gate: unit and integration tests, and the manual
#        tests/run.sh tests/unit                   # unit tests alone: less than two minutes
#        tests/run.sh -m nightly                   # Slurm, Kaldi, faults
set -euo pipefail
cd "$(dirname "$0")/.."
. ./path.sh
local/install.sh requirements.txt tests/requirements.txt docs/requirements.txt
[ "${1:-}" != --install-only ] || exit 0
ruff check pysrc local tests docs
shellcheck -x run.sh path.sh cmd.sh utils/*.sh steps/*.sh local/*.sh local/kaldi/*.sh tests/*.sh tests/{bench,peers}/*.sh \
  tests/nightly/faults/*.sh .ci/run
mypy
[ $# -gt 0 ] || sphinx-build -q -W --keep-going -b html docs docs/_build/html
python -m pytest -q "$@"
