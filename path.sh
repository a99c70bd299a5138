# shellcheck shell=bash
# Environment of every script: source it from the recipe's own directory (`. ./path.sh`).
[ -f ./path.sh ] && [ -d ./pysrc/roomeq ] || {
  echo "path.sh: call this from the directory that holds run.sh, not from $PWD" >&2
  # shellcheck disable=SC2317 # reached where it is run instead of sourced
  return 1 2>/dev/null || exit 1
}
if [ -n "${BASH_VERSION:-}" ] && [ $((BASH_VERSINFO[0] * 100 + BASH_VERSINFO[1])) -lt 404 ]; then
  echo "path.sh: bash $BASH_VERSION is too old: 4.4 or newer is needed" >&2
  # shellcheck disable=SC2317 # as above
  return 1 2>/dev/null || exit 1
fi
case $PWD in
  *[:\"\$\`\\]* | *'
'*)
    echo "path.sh: the directory '$PWD' must be renamed: its path may not hold a colon (which separates the entries of" \
      "PATH), quotation mark, dollar sign, backquote, backslash or line break" >&2
    # shellcheck disable=SC2317 # as above
    return 1 2>/dev/null || exit 1
    ;;
esac
ROOMEQ_DIR=$PWD
export ROOMEQ_DIR
export PATH="$ROOMEQ_DIR/.venv/bin:$PATH"
# Python takes packages on PYTHONPATH before those of .venv, so what a user has there is left out
[ -z "${PYTHONPATH:-}" ] || [ -f "$PYTHONPATH/roomeq/__init__.py" ] ||
  echo "path.sh: PYTHONPATH='$PYTHONPATH' is ignored: the recipe runs with the packages that it pins" >&2
export PYTHONPATH="$ROOMEQ_DIR/pysrc"
unset PYTHONHOME PYTHONDONTWRITEBYTECODE # compiled code is kept beside the sources in any case
export LC_ALL=C PYTHONUTF8=1
# work is split into jobs, and each job uses one thread
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1
