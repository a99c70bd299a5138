# shellcheck shell=bash
# Run jobs through $cmd, which write to a log and may run elsewhere, and show their progress. Sourced.
# Usage: run_jobs DIR JOB=1:4 LOG roomeq ...
# The jobs write their state below DIR/.progress, which all machines must see. On a terminal, one line is rewritten every
# second; elsewhere a line a minute is printed. All jobs together are counted.

progress_text() { # DIR: "label: done of all, time left" of all jobs, or nothing
  { cat -- "$1"/[!.]* 2>/dev/null || true; } | awk '
    $1 ~ /^[0-9]+$/ && $2 ~ /^[0-9]+$/ {
      done += $1; total += $2; if ($3 > left) left = $3
      if (label == "") { label = $4; for (n = 5; n <= NF; n++) label = label " " $n }
      if (++jobs > 1) sub(/ \(.*\)$/, "", label)
    }
    function duration(s) {
      if (s < 60) return s " s"
      return s < 3600 ? int(s / 60) " min " s % 60 " s" : int(s / 3600) " h " int(s % 3600 / 60) " min"
    }
    END { if (total) print label ": " done " of " total (left > 0 ? ", " duration(left) " left" : "") }'
}

show_progress() { # DIR: until the directory is gone, or the script that sourced this
  local text waited=0 width
  while sleep 1 && [ -d "$1" ] && kill -0 $$ 2>/dev/null; do
    text=$(progress_text "$1") || continue
    [ -n "$text" ] || continue
    if [ -t 2 ]; then
      width=$(stty size <&2 2>/dev/null | cut -d ' ' -f 2) || width=0
      [ "${width:-0}" -gt 0 ] || width=80
      printf '\r\033[K%s' "${text:0:width-1}" >&2
    elif ((waited++ % 60 == 59)); then
      printf '%s\n' "$text" >&2
    fi
  done
}

run_jobs() { # DIR ARGUMENT...: run $cmd ARGUMENT...
  begin_progress "$1"
  # $cmd, set by cmd.sh, may hold options ("queue.pl --mem 2G"): split on purpose
  # shellcheck disable=SC2086,SC2154
  $cmd "${@:2}"
  end_progress
}

begin_progress() { # DIR
  ROOMEQ_PROGRESS=$(realpath -m -- "$1")/.progress
  export ROOMEQ_PROGRESS
  rm -rf -- "$ROOMEQ_PROGRESS"
  mkdir -p -- "$ROOMEQ_PROGRESS" 2>/dev/null || return 0 # the step says what is wrong with the directory
  show_progress "$ROOMEQ_PROGRESS" </dev/null >/dev/null &
  progress_pid=$!
  trap end_progress EXIT
}

end_progress() {
  [ -n "${progress_pid:-}" ] || return 0
  kill "$progress_pid" 2>/dev/null || true
  wait "$progress_pid" 2>/dev/null || true
  [ ! -t 2 ] || printf '\r\033[K' >&2
  rm -rf -- "$ROOMEQ_PROGRESS"
  unset ROOMEQ_PROGRESS progress_pid
  trap - EXIT
}
