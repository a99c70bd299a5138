# shellcheck shell=bash disable=SC2154 # the options of run.sh
# Check the options of run.sh before any work. The tools check them too, but some only after hours. Sourced by run.sh.
number='[-+]?[0-9]*\.?[0-9]+'
distribution="none|$number|(uniform|normal) +${number}[ ,]+$number|list +(${number}[ ,]+)*$number"
distribution_rule="'uniform LOW HIGH', 'normal MEAN SD', 'list A,B,...', a number or none"

in_range() { # NAME LOW HIGH: stop unless a whole number lies in this range
  [[ ${!1} =~ ^(0|-?[1-9][0-9]*)$ && ${!1} -ge $2 && ${!1} -le $3 ]] || die "--${1//_/-} '${!1}' must lie in [$2, $3]"
}
in_range nj 1 1024
check_option stop_stage '[0-9]|10' "a whole number up to 10"
check_option split_by 'rir|room' "rir or room"
check_option split_sizes '0*[1-9][0-9]*,0*[1-9][0-9]*,0*[1-9][0-9]*' "three counts from 1, as 773,194,242"
time='([0-9]+\.?[0-9]*|\.[0-9]+)'
check_option t60_range "$time,$time|measured" "two times, as 0.2,2.0, or measured"
[ "$t60_range" = measured ] || awk -F, '{ exit !(0.05 <= $1 && $1 <= $2 && $2 <= 10) }' <<<"$t60_range" ||
  die "--t60-range '$t60_range' must be two times in [0.05, 10] s, the smaller first"
check_option rooms '([1-9][0-9]{0,5})?' "a number of rooms, or empty"
check_option free_rooms '0|[1-9][0-9]{0,5}' "a number of rooms, or 0"
in_range num_rays 100 10000000
in_range order 1 10000
[ "$num_components" -ge 1 ] || die "--num-components '$num_components' must be at least 1"
check_option taps '[0-9]*[13579]' "odd"
in_range taps 3 4095
in_range max_effects 0 11
check_option snr "$distribution" "$distribution_rule"
check_option point_snr "$distribution" "$distribution_rule"
check_option packing 'recording|utterance' "recording or utterance"
in_range test_copies 1 1000
check_option align_on 'clean|self' "clean or self"
pass=' *(mono +(all|[0-9]+)|(deltas|lda_mllt|sat) +(all|[0-9]+) +[0-9]+ +[0-9]+) *'
check_option gmm_passes "$pass(,$pass)*" "passes as 'mono 300, deltas all 300 3000': kind, utterances, leaves, Gaussians"
[ "$stage" -le "$stop_stage" ] || die "--stage $stage comes after --stop-stage $stop_stage: nothing is to be done"
[ -z "$librispeech" ] || [ -z "$speech" ] || die "--librispeech and --speech both name the speech: leave one out"
[ -z "$reverbdb" ] || [ -z "$measured" ] || die "--reverbdb and --measured both name the measured RIRs: leave one out"
[ "$dry_run" = false ] || [ "$stage" -ge 8 ] || die "--dry-run prints the Kaldi commands: add --stage 8"
[ -z "$room_types" ] || [ -n "$rooms" ] || [ "$free_rooms" != 0 ] ||
  die "--room-types '$room_types' is of drawn rooms: give --rooms or --free-rooms"
if [[ $room_types == *.toml ]]; then
  [ -f "$room_types" ] || die "--room-types '$room_types': no such file: check the path"
elif [ ! -f "$room_types" ]; then
  for x in ${room_types//,/ }; do
    grep -qxF "[$x]" conf/room_types.toml ||
      die "--room-types '$room_types': '$x' must be a TOML file or a type in conf/room_types.toml: correct the name"
  done
fi
if [ "$stage" -eq 0 ]; then
  for x in librispeech reverbdb speech measured dev_rirs test_rirs noises; do
    [ -z "${!x}" ] || [ -e "${!x}" ] || die "--${x//_/-} '${!x}': no such file or directory: check the path"
  done
fi
if [ -n "$rooms" ] && [ "$free_rooms" != 0 ]; then
  log "--rooms draws all rooms: no set sim.free is made beside"
  free_rooms=0
fi
[ -z "$rooms" ] || log "--rooms draws all rooms: their T60 is that of the types of rooms, not of --t60-range"
if [ "$stop_stage" -ge 8 ]; then
  sets="clean real.rvb sim.rvb sim.EQ.rvb sim.loop.rvb$([ "$free_rooms" = 0 ] || echo " sim.free.rvb")"
  for x in $rows; do
    [[ " $sets " == *" $x "* ]] || die "--rows: '$x' must be one of: $sets"
  done
  [ -z "$lm_text" ] || [ -f "$lm_text" ] || die "--lm-text '$lm_text': no such file"
  [ "$dry_run" = true ] || (. local/kaldi/common.sh && require_plain --exp "$exp")
  # wrong ones would stop after hours; the scripts say what is wrong
  read -ra x <<<"$chain_opts"
  local/kaldi/train_chain.sh --dry-run true "${x[@]}" exp/kaldi train train >/dev/null || die "--chain-opts: see above"
  read -ra x <<<"$decode_opts"
  local/kaldi/decode.sh --dry-run true "${x[@]}" exp/kaldi train train test >/dev/null || die "--decode-opts: see above"
  [ "$dry_run" = true ] || [ "$stage" -gt 8 ] || (. local/kaldi/common.sh && kaldi_root >/dev/null)
  unset sets
fi
unset -f in_range
unset number distribution distribution_rule time pass x
