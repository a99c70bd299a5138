# shellcheck shell=bash
# one_run DIR...: stop if another run works in one of these directories, and say which. Sourced after parse_options.sh.
# The lock is that of the open file DIR/.run.lock, which names its holder: it ends with this process and its jobs. The
# jobs of a killed run end within ten seconds (end_together.sh), for which the next run waits.
one_run() {
  local dir lock handle
  for dir in "$@"; do
    [ -n "$dir" ] || die "a directory has an empty name: give --data and --exp a path"
    lock=$dir/.run.lock
    { mkdir -p -- "$dir" && : >>"$lock"; } 2>/dev/null || die "$lock cannot be written: is the disk full or read-only?"
    [ ! "$lock" -ef "${ONE_RUN:-}" ] || continue # the same directory twice
    ONE_RUN=$lock
    exec {handle}<>"$lock"
    flock --timeout 15 --conflict-exit-code 9 "$handle" || case $? in
      9) die "$dir: another run works there: $(head -c 1000 "$lock" | tr -c '[:print:]' ' ')" ;;
      *) log "$dir: no locks here: let one run at a time work there" ;;
    esac
    # shellcheck disable=SC2154 # parse_options.sh sets options_given
    printf 'process %s on %s since %s: %s\n' "${ROOMEQ_RUN%%.*}" "$(uname -n)" "$(date '+%Y-%m-%d %H:%M:%S')" \
      "$0 ${options_given[*]}" >"$lock"
  done
}
