#!/usr/bin/env bash
# Run scripts that use roomeq beside another toolkit, in a fresh environment with that toolkit as its makers publish it.
# Usage: tests/peers/run.sh [pyroomacoustics|audiomentations|lhotse ...]
# e.g.:  tests/peers/run.sh pyroomacoustics audiomentations
# A toolkit that cannot be installed is left out, and that is said; lhotse brings torch, some gigabytes.
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -gt 0 ] || set -- pyroomacoustics audiomentations lhotse
# lhotse imports urllib3 without saying so
declare -A packages=([pyroomacoustics]="pyroomacoustics==0.10.1" [audiomentations]="audiomentations==0.43.1"
                     [lhotse]="lhotse==1.33.0 urllib3==2.5.0")
declare -A script=([pyroomacoustics]=pyroomacoustics_readme [audiomentations]=audiomentations_chain [lhotse]=lhotse_cut)

for peer; do
  [ -n "${packages[$peer]:-}" ] || { echo "tests/peers/run.sh: $peer: must be one of ${!packages[*]}" >&2 && exit 2; }
  read -ra wanted <<<"${packages[$peer]}"
  environment=$(mktemp -d "${TMPDIR:-/tmp}/roomeq-$peer.XXXXXX")
  trap 'rm -rf "$environment"' EXIT
  python3 -m venv "$environment"
  if ! "$environment/bin/python" -m pip install --quiet . "${wanted[@]}" >"$environment/log" 2>&1; then
    echo "tests/peers/run.sh: ${wanted[*]}: not to be had here, the script is skipped: $(tail -n 1 "$environment/log")"
  else
    (cd / && env -u PYTHONPATH "$environment/bin/python" "$OLDPWD/tests/peers/${script[$peer]}.py")
  fi
  rm -rf "$environment"
done
