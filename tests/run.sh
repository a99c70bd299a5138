#!/usr/bin/env bash
# Check everything: installs what is missing into .venv, then ruff, shellcheck and pytest.
# Usage: tests/run.sh [--install-only] [pytest arguments]
# e.g.:  tests/run.sh tests/test_build.py
set -euo pipefail
cd "$(dirname "$0")/.."
. ./path.sh
local/install.sh requirements.txt tests/requirements.txt docs/requirements.txt
[ "${1:-}" != --install-only ] || exit 0
ruff check pysrc local tests
shellcheck -x run.sh path.sh cmd.sh utils/*.sh steps/*.sh local/*.sh local/kaldi/*.sh tests/*.sh tests/bench/*.sh .ci/run
python -m pytest -q "$@"
