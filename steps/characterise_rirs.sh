#!/usr/bin/env bash
# Measure every RIR (T60, C50, DRR, EQ ...), leave out repeats, uncommon rooms and recordings that are no RIR, and mark
# RIRs unfit for the EQ fit.
# Usage: steps/characterise_rirs.sh [--nj 2] [--keep-suspicious false] <rir-dir> <rir-dir-out>
# e.g.:  steps/characterise_rirs.sh data/measured data/rirs.real
set -euo pipefail
nj=2                    # jobs
keep_suspicious=false   # keep recordings that are no RIR by their acoustics
. ./path.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
require "$1/rirs.jsonl" steps/read_measured.sh
flags=()
[ "$keep_suspicious" = false ] || flags=(--keep-suspicious)
utils/run_parts.sh "$nj" "$(dirname "$2")/log/$(basename "$2")" characterise "${flags[@]}" "$1" "$2"
