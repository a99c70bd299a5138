#!/usr/bin/env bash
# Make one self-contained HTML page of a run: figures, tables, audio.
# Usage: steps/make_report.sh [--kinds real,sim,sim.EQ] <data-dir> <exp-dir> <report-dir>
# e.g.:  steps/make_report.sh data exp exp/report
set -euo pipefail
kinds=real,sim.free,sim,sim.EQ,sim.loop   # kinds of RIRs to report, where they are there
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
roomeq report --kinds "$kinds" "$1" "$2" "$3"
