# shellcheck shell=bash
# The command that runs the jobs of a step. It follows Kaldi's calling convention, `JOB=1:n LOG COMMAND...`.
# The default runs local processes. With Kaldi, for example:
#   export cmd="$KALDI_ROOT/egs/wsj/s5/utils/parallel/queue.pl --mem 2G"
export cmd="${cmd:-utils/local.sh}"
