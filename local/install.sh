#!/usr/bin/env bash
# Install the pinned Python packages into .venv, if they are not there; needs no root.
# Usage: local/install.sh [requirements.txt ...]
# e.g.:  local/install.sh requirements.txt tests/requirements.txt
# Every file that pip may take is pinned by its hash. An environment that was moved, copied or damaged, or whose Python
# is gone or another one, is made again.
set -euo pipefail
. ./path.sh
[ $# -gt 0 ] || set -- requirements.txt
log=.venv.log # of pip

die() {
  printf 'install.sh: %s\n' "$*" >&2
  exit 1
}

# The mark vouches for an environment at this place, of this Python and machine and with these requirements. It lists the
# files that must be there; the content of all files was checked before it was written.
find_mark() {
  mark=.venv/.installed-$({
    cat pyproject.toml "$@"
    .venv/bin/python -I -S -c 'import os, sys; print(sys.implementation.cache_tag, os.uname().machine)' || true
    (cd -P .venv && pwd) || true
  } 2>/dev/null | sha256sum | cut -c1-16)
}

is_marked() {
  local file
  find_mark "$@"
  [ -s "$mark" ] || return 1
  while IFS= read -r file; do [ -e ".venv/$file" ] || return 1; done <"$mark"
}

# Check .venv file by file, and mark it. Otherwise set `problem` and return 1 if pip mends it, or 2.
is_whole() {
  local status=0 files
  problem="its Python $(readlink .venv/bin/python || true) is gone or does not run"
  .venv/bin/python -I -S -c '' 2>/dev/null || return 2
  files=$(.venv/bin/python -I local/check_environment.py "$@" 2>&1) || status=$?
  problem=$(tail -n 1 <<<"$files")
  [ "$status" = 0 ] || return $((status == 1 ? 1 : 2))
  find_mark "$@"
  sync -f .venv || true
  { printf '%s\n' "$files" >"$mark.tmp" && mv "$mark.tmp" "$mark"; } 2>/dev/null || true # of another user
}

find_python() {
  local name path
  for name in python3 python3.14 python3.13 python3.12 python3.11; do
    while IFS= read -r path; do
      [[ $path != "$PWD/.venv/"* ]] || continue
      if "$path" -I -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null; then
        printf '%s\n' "$path" && return
      fi
    done < <(type -ap "$name")
  done
  die "Python 3.11, 3.12, 3.13 or 3.14 is needed: PATH has $(python3 --version 2>&1 || true)"
}

# Put back the environment that was there, and say why there is no new one.
fail() {
  if [ -e .venv.old ]; then rm -rf .venv && mv .venv.old .venv; fi
  die "$1: $("$python" -I local/explain_pip.py "$log") (log: $log)"
}

make_environment() {
  if [ -e .venv.old ]; then rm -rf .venv; elif [ -e .venv ]; then mv .venv .venv.old; fi
  "$python" -m venv .venv >"$log" 2>&1 || { rm -rf .venv && fail "$python -m venv failed"; }
  # older Pythons add it
  ! compgen -G '.venv/lib/*/site-packages/setuptools' >/dev/null || .venv/bin/python -m pip --quiet uninstall --yes setuptools
}

install_packages() {
  local file requirements=() pip=(.venv/bin/python -m pip --disable-pip-version-check install --quiet)
  for file; do requirements+=(-r "$file"); done
  {
    "${pip[@]}" --require-hashes --only-binary :all: -r local/build-requirements.txt &&
      "${pip[@]}" --require-hashes --only-binary :all: "${requirements[@]}" &&
      "${pip[@]}" --no-build-isolation --no-deps -e .
  } >"$log" 2>&1 || fail "pip cannot install the packages"
}

if is_marked "$@" && [ ! -e .venv.old ]; then exit 0; fi
[ "$(uname -s)" = Linux ] || echo "install.sh: tested on Linux only; continuing" >&2
if [ -L .venv ]; then
  is_whole "$@" || die ".venv is a link to $(readlink .venv), where $problem: run local/install.sh there, or remove the link"
  exit 0
fi
{ : >>.venv.lock; } 2>/dev/null || die "$PWD/.venv.lock cannot be written: is the disk full or read-only?"
exec 9>>.venv.lock
flock 9 || echo "install.sh: no locks here: let one installation at a time run" >&2 # two runs may start at once
if is_marked "$@"; then rm -rf .venv.old && exit 0; fi
python=$(find_python)
# what would lead pip elsewhere, or to other files
unset PIP_TARGET PIP_PREFIX PIP_ROOT PIP_NO_BINARY PIP_REQUIRE_HASHES PIP_DRY_RUN
export PIP_USER=0
status=0
is_whole "$@" || status=$?
[ "$status" != 2 ] || [ ! -e .venv ] || echo "install.sh: .venv is made again: $problem"
[ "$status" = 0 ] || echo "install.sh: installing Python packages into .venv (about a minute, first run only)"
if [ "$status" = 1 ]; then
  install_packages "$@"
  status=0
  is_whole "$@" || status=2 # a package that pip took for installed was not
fi
if [ "$status" = 2 ]; then
  make_environment
  install_packages "$@"
  is_whole "$@" || die "after the installation, in .venv: $problem: does pip's configuration (python3 -m pip config" \
    "list) name another folder, as target or prefix?"
fi
rm -rf .venv.old "$log"
# otherwise the first simulation waits for the compiler
.venv/bin/python -m roomeq.compile_kernels >/dev/null 2>&1 ||
  echo "install.sh: the kernels of simulator and loop are compiled when they are first used"
