# shellcheck shell=bash
# Who runs the jobs of a step: anything that takes Kaldi's `JOB=1:n LOG COMMAND...`.
# Local processes by default; with Kaldi at hand also, for example,
#   export cmd="$KALDI_ROOT/egs/wsj/s5/utils/parallel/queue.pl --mem 2G"
export cmd="${cmd:-utils/local.sh}"
