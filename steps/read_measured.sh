#!/usr/bin/env bash
# Read measured RIRs (BUT ReverbDB, SOFA, OpenSLR 28, CSV or a plain folder) into an RIR directory.
# Usage: steps/read_measured.sh [--noises DIR] <corpus> <rir-dir>
# e.g.:  steps/read_measured.sh /corpora/BUT_ReverbDB data/measured
set -euo pipefail
noises=   # folder of noise recordings to add to those of the corpus
. ./path.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
roomeq read-measured ${noises:+--noises "$noises"} "$1" "$2"
