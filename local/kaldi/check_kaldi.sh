#!/usr/bin/env bash
# Check that a workspace finds Kaldi's tools, and that OpenFst's do what the stock scripts want, which shows in stage 10
# otherwise.
# Usage: local/kaldi/check_kaldi.sh <workspace>
# e.g.:  local/kaldi/check_kaldi.sh exp/kaldi
# Prints Kaldi's version, and adds it to <workspace>/kaldi_version. If the fstproject of a recent OpenFst does not
# know --project_output, which stock scripts give it, <workspace>/bin/fstproject translates this option.
set -euo pipefail
. ./path.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
workspace=$1
require "$workspace/path.sh" local/kaldi/make_workspace.sh
cd "$workspace"
. ./path.sh

missing=()
for tool in flac sox perl python3 gzip fstcompile fstprint fstproject arpa2fst fsttablecompose compute-mfcc-feats \
  gmm-est-fmllr gmm-est-fmllr-gpost chain-est-phone-lm nnet-get-feature-transform nnet3-chain-train \
  nnet3-latgen-faster lattice-lmrescore-const-arpa online2-wav-nnet3-latgen-faster compute-wer-bootci; do
  command -v "$tool" >/dev/null || missing+=("$tool")
done
[ ${#missing[@]} = 0 ] || die "not found: ${missing[*]}: install them, or compile Kaldi in $KALDI_ROOT/src"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
printf '<eps> 0\na 1\n<s> 2\n</s> 3\n#0 4\n' >"$work/words.txt"
cat >"$work/lm.arpa" <<'EOF'

\data\
ngram 1=3
ngram 2=2

\1-grams:
-0.3 </s>
-99 <s> -0.1
-0.3 a -0.1

\2-grams:
-0.1 <s> a
-0.1 a </s>

\end\
EOF
made=$work/arpa2fst.log
arpa2fst --disambig-symbol=#0 --read-symbol-table="$work/words.txt" "$work/lm.arpa" "$work/G.fst" 2>"$made" || {
  status=$?
  die "$(command -v arpa2fst) fails on a language model of one word (exit status $status, \
$(grep -m 1 ERROR "$made" || tail -n 1 "$made")): compile Kaldi with the OpenFst that it finds at run time"
}

# Project an FST whose one arc has input label 1 and output label 2, and print the output label.
projected() {
  printf '0 1 1 2\n1\n' | fstcompile | "$fstproject" "$1" 2>"$work/log" | fstprint 2>/dev/null | awk 'NF == 4 {print $4}'
}
fstproject=$(PATH=${PATH#"$PWD/bin:"} command -v fstproject) # not the one that this script writes
if [ "$(projected --project_output=true)" = 2 ]; then
  rm -f bin/fstproject
else
  [ "$(projected --project_type=output)" = 2 ] ||
    die "$fstproject projects neither with --project_output=true nor with --project_type=output \
($(tail -n 1 "$work/log")): install the OpenFst of Kaldi's tools/Makefile"
  mkdir -p bin
  cat >bin/fstproject.new <<EOF
#!/usr/bin/env bash
exec $(printf %q "$fstproject") "\${@/#--project_output=true/--project_type=output}"
EOF
  chmod +x bin/fstproject.new && mv bin/fstproject.new bin/fstproject
  log "fstproject of this OpenFst does not know --project_output: the workspace translates it"
fi
version=$(sed -n 's/^[A-Z]* (arpa2fst\[\([^]]*\)\].*/\1/p' "$made" | head -n 1)
version=${version:-of unknown version}
grep -qxF "$version" kaldi_version 2>/dev/null || echo "$version" >>kaldi_version
log "Kaldi $version in $KALDI_ROOT"
