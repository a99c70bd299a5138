#!/usr/bin/env bash
# Measure every RIR (T60, C50, DRR, EQ ...), and mark repeats, uncommon rooms and RIRs unfit for the EQ fit.
# Usage: steps/characterise_rirs.sh [--nj 2] <rir-dir> <rir-dir-out>
# e.g.:  steps/characterise_rirs.sh data/measured data/rirs.real
set -euo pipefail
nj=2   # jobs
. ./path.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
require "$1/rirs.jsonl" steps/read_measured.sh
utils/run_parts.sh "$nj" "$(dirname "$2")/log" characterise "$1" "$2"
