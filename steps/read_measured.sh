#!/usr/bin/env bash
# Read measured RIRs (BUT ReverbDB, SOFA, OpenSLR 28, CSV or a plain folder) into an RIR directory.
# Usage: steps/read_measured.sh [--noises DIR] [--keep-suspicious false] <corpus> <rir-dir>
# e.g.:  steps/read_measured.sh /corpora/BUT_ReverbDB data/measured
set -euo pipefail
noises=   # folder of noise recordings to add to those of the corpus
keep_suspicious=false   # keep recordings that are no RIR by their acoustics
. ./path.sh
. utils/ask.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
flags=()
[ "$keep_suspicious" = false ] || flags=(--keep-suspicious)
run_verb read-measured ${noises:+--noises "$noises"} "${flags[@]}" "$1" "$2"
