#!/usr/bin/env bash
# Make one self-contained HTML page of a run: figures, tables, audio.
# Usage: steps/make_report.sh <data-dir> <exp-dir> <report-dir>
# e.g.:  steps/make_report.sh data exp exp/report
set -euo pipefail
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
roomeq report "$1" "$2" "$3"
