# shellcheck shell=bash
# Turn --some-option VALUE into the variable some_option, which the script must have set before it sources this file.
# It also reads --config FILE (lines `some_option=value  # comment`; a pair of quotes around a value is left out),
# answers --help, and defines the functions below. Values are assigned and never evaluated. Sourced: the remaining
# arguments stay in "$@", and all of them in options_given. The script ends with all that it starts (end_together.sh).

. utils/end_together.sh

# Print the caller's header comment and options: `usage 0` to stdout with exit 0, `usage` to stderr with exit 1.
usage() {
  {
    sed -n '/^# /{s/^# //;p};/^set -/q' "$0" | grep -v '^shellcheck '
    echo "Options:"
    sed -n '/^set -/,/parse_options\.sh/s/^\([a-z][a-z0-9_]*\)=\([^#]*\)\(#.*\)\{0,1\}$/\1|\2|\3/p' "$0" |
      while IFS='|' read -r name default comment; do
        read -r default <<<"$default" # trims
        printf '  %-30s  %s\n' "--${name//_/-} $default" "${comment#\# }"
      done
  } >&"$((${1:-1} + 1))"
  exit "${1:-1}"
}

# Print one line to stderr and stop.
die() {
  printf '%s: %s\n' "${0##*/}" "$*" >&2
  exit 1
}

# require FILE STEP: stop unless FILE, the output of STEP, exists.
require() {
  [ -e "$1" ] || die "$1 is missing: run $2 first"
}

# check_option NAME PATTERN RULE: stop unless the value of an option matches a regular expression as a whole.
check_option() {
  [[ ${!1} =~ ^($2)$ ]] || die "--${1//_/-} '${!1}' must be $3"
}

# Print a line with the time of day.
log() {
  printf '%(%H:%M:%S)T %s: %s\n' -1 "${0##*/}" "$*"
}

# at_stage NUMBER TITLE: tell whether a stage is to run, and announce it.
at_stage() {
  # shellcheck disable=SC2154 # options of the caller
  [ "$stage" -le "$1" ] && [ "$stop_stage" -ge "$1" ] && log "stage $1: $2"
}

set_option() { # NAME VALUE WHERE
  local name=${1//-/_}
  [[ $name =~ ^[a-z][a-z0-9_]*$ && $name != PATH ]] && [[ ${options_known:-} == *" $name "* ]] ||
    die "${3:+$3: }unknown option '$1'; see --help"
  local default=${option_defaults[$name]}
  if [[ $default == true || $default == false ]] && [[ $2 != true && $2 != false ]]; then
    die "${3:+$3: }--$1 '$2' must be true or false"
  fi
  if [[ $default =~ ^[0-9]+$ ]]; then
    [[ $2 =~ ^[0-9]{1,9}$ ]] || die "${3:+$3: }--$1 '$2' must be a whole number"
    set -- "$1" "$((10#$2))" "${3:-}" # bash takes 08 for a number in base eight
  fi
  printf -v "$name" '%s' "$2"
}

read_config() { # FILE
  local line name value number=0 names=' '
  [ -f "$1" ] || die "--config $1: no such file"
  while IFS= read -r line || [ -n "$line" ]; do
    number=$((number + 1))
    [ "$number" -gt 1 ] || line=${line#$'\xef\xbb\xbf'} # a byte order mark
    line=" $line" && line=${line%%[[:space:]]#*} && line=${line# } # a comment starts the line or follows a blank
    line=${line%"${line##*[![:space:]]}"}
    [ -n "$line" ] || continue
    [[ $line == *=* ]] || die "$1:$number: '$line' must be name=value"
    name=${line%%=*} && name=${name//-/_}
    [[ $names != *" $name "* ]] || die "$1:$number: $name is set twice: leave one line out"
    names+="$name "
    value=${line#*=}
    [[ ! $value =~ ^\"([^\"]*)\"$ && ! $value =~ ^\'([^\']*)\'$ ]] || value=${BASH_REMATCH[1]} # as in a script
    set_option "${line%%=*}" "$value" "$1:$number"
  done <"$1"
}

# the options of a script are the variables that it assigns, at the start of a line, before it sources this file
options_known=" $(sed -n '/parse_options\.sh/q;s/^\([a-z][a-z0-9_]*\)=.*/\1/p' "$0" | tr '\n' ' ')"
declare -A option_defaults
for flag in $options_known; do option_defaults[$flag]=${!flag}; done
# shellcheck disable=SC2034 # options_given is for other scripts
options_given=("$@") options_set=() # names and values of the command line, which follow those of the config file
while [ $# -gt 0 ]; do
  case $1 in
    --help | -h) usage 0 ;;
    --config) read_config "${2:-}" && shift 2 ;;
    --config=*) read_config "${1#*=}" && shift ;;
    --*=*) options_set+=("$(cut -d= -f1 <<<"${1#--}")" "${1#*=}") && shift ;;
    --) shift && break ;;
    --*)
      flag=${1#--} && flag=${flag//-/_}
      # a switch without a value
      if [[ $flag =~ ^[a-z][a-z0-9_]*$ && ${option_defaults[$flag]:-} == false && ${2:---} == --* ]]; then
        options_set+=("${1#--}" true) && shift && continue
      fi
      [ $# -gt 1 ] || die "$1 needs a value; see --help"
      next=${2#--} && next=${next//-/_}
      [[ $2 != --* || $options_known != *" ${next%%=*} "* ]] || die "$1 needs a value, and $2 is an option; see --help"
      options_set+=("${1#--}" "$2") && shift 2
      ;;
    *) break ;;
  esac
done
for ((i = 0; i < ${#options_set[@]}; i += 2)); do
  set_option "${options_set[i]}" "${options_set[i + 1]}" ""
done
unset options_known option_defaults options_set flag next i
