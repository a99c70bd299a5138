"""Options of shell scripts are assigned and never evaluated; the local runner names a failing job."""

import os
import subprocess

import numpy as np
import pytest
import soundfile
from rirmaker import coloured_rir, row, write_rir_dir
from scripts import call

from roomeq.augment.distribution import parse_distribution
from roomeq.core.build import MAX_JOBS
from roomeq.effects.catalogue import CATALOGUE
from roomeq.eq.steps import MAX_TAPS


def test_options_take_values_with_and_without_equals_sign(recipe):
    done = call(recipe, "./say.sh", "--nj", "7", "--some-name=a b", "--fast", "true", "say.sh")
    assert (done.returncode, done.stdout) == (0, "7|a b|true|say.sh|")


@pytest.mark.parametrize(
    "value", ["$(touch evil)", "`touch evil`", "'; touch evil; '", "a\nb", "-x", "*", "../x", "é"])
def test_option_values_are_never_evaluated(recipe, value):
    (recipe / "size.conf").write_text(f"some_name={value.splitlines()[0]}\n")
    done = call(recipe, "./say.sh", "--some-name", value, "say.sh")
    assert (done.returncode, done.stdout) == (0, f"2|{value}|false|say.sh|")
    done = call(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    in_config = value.splitlines()[0].strip("'")  # a pair of quotes around a value is no part of it
    assert (done.returncode, done.stdout) == (0, f"2|{in_config}|false|say.sh|")
    assert not (recipe / "evil").exists()


@pytest.mark.parametrize("value, number", [("08", "8"), ("010", "10"), ("00", "0")])
def test_number_with_leading_zeros_is_decimal(recipe, value, number):
    assert call(recipe, "./say.sh", "--nj", value, "say.sh").stdout == f"{number}||false|say.sh|"
    (recipe / "size.conf").write_text(f"nj={value}\n")
    assert call(recipe, "./say.sh", "--config", "size.conf", "say.sh").stdout == f"{number}||false|say.sh|"


def test_command_line_wins_over_config(recipe):
    (recipe / "size.conf").write_text("# sizes\nnj=3   # three\n\nsome_name=x\n")
    assert call(recipe, "./say.sh", "--nj", "4", "--config", "size.conf", "say.sh").stdout == "4|x|false|say.sh|"


@pytest.mark.parametrize("line, value", [("/x/my#1/data", "/x/my#1/data"), ("#1", "#1"), ("a#b # c # d", "a#b"),
                                         ("a\t# b", "a"), (" # b", ""), ('"a b"  # c', "a b"),
                                         ("'a'", "a"), ('a"b"', 'a"b"'), ('"a', '"a')])
def test_comment_of_a_config_follows_a_blank(recipe, line, value):
    (recipe / "size.conf").write_text(f"#nj=3\n # of names\nsome_name={line}\n")
    done = call(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    assert (done.returncode, done.stdout) == (0, f"2|{value}|false|say.sh|")


def test_config_of_windows_is_read(recipe):
    (recipe / "size.conf").write_bytes(b"\xef\xbb\xbfnj=3 # three\r\n\r\nsome_name=a b\r\n")
    done = call(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    assert (done.returncode, done.stdout) == (0, "3|a b|false|say.sh|")


def test_config_that_sets_an_option_twice_is_refused(recipe):
    (recipe / "size.conf").write_text("some_name=a\nnj=3\nsome-name=b\n")
    done = call(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    assert (done.returncode, done.stderr) == (1, "say.sh: size.conf:3: some_name is set twice: leave one line out\n")


def test_rule_for_values_is_that_of_the_default_not_of_the_config(recipe):
    (recipe / "size.conf").write_text("some_name=10\n")
    for name in ("uniform 0 15", ""):
        done = call(recipe, "./say.sh", "--config=size.conf", "--some-name", name, "say.sh")
        assert (done.returncode, done.stdout) == (0, f"2|{name}|false|say.sh|")
    assert call(recipe, "./say.sh", "--config=size.conf", "say.sh").stdout == "2|10|false|say.sh|"
    (recipe / "size.conf").write_text("fast=true\n")  # a switch is one whatever the config says
    done = call(recipe, "./say.sh", "--config", "size.conf", "--fast", "--nj", "4", "say.sh")
    assert done.stdout == "4||true|say.sh|"


def test_config_of_another_script_is_a_value(recipe):
    for value in ("--config=absent.conf", "--config=absent.conf --dim 9", "--config absent.conf"):
        assert call(recipe, "./say.sh", "--some-name", value, "say.sh").stdout == f"2|{value}|false|say.sh|"


@pytest.mark.parametrize("args, message", [
    (["--nope", "1", "say.sh"], "unknown option 'nope'"),
    (["--PATH", "1", "say.sh"], "unknown option 'PATH'"),
    (["--options-given", "1", "say.sh"], "unknown option"),
    (["--nj"], "--nj needs a value"),
    (["--some-name", "--nj", "3", "say.sh"], "--some-name needs a value, and --nj is an option"),
    (["--fast", "yes", "say.sh"], "must be true or false"),
    (["--config", "absent.conf", "say.sh"], "absent.conf: no such file"),
    (["absent"], "absent is missing: run steps/before.sh first"),
    ([], "Usage:"),
])
def test_wrong_options_are_named(recipe, args, message):
    done = call(recipe, "./say.sh", *args)
    assert done.returncode != 0
    assert message in done.stderr and done.stdout == ""


@pytest.mark.parametrize("line, message", [("nope=1", "unknown option 'nope'"), ("nj 3", "must be name=value")])
def test_wrong_config_lines_are_named_with_their_number(recipe, line, message):
    (recipe / "size.conf").write_text(f"nj=3\n{line}\n")
    done = call(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    assert done.returncode != 0 and "size.conf:2: " in done.stderr and message in done.stderr


def test_help_prints_header_and_options(recipe):
    done = call(recipe, "./say.sh", "--help")
    assert done.returncode == 0
    assert "Say what the options are." in done.stdout and "--some-name" in done.stdout and "jobs" in done.stdout


def test_every_script_has_help(project_dir):
    scripts = [project_dir / "run.sh", project_dir / "local/make_synthetic_corpus.sh", *project_dir.glob("steps/*.sh"),
               *(path for path in project_dir.glob("local/kaldi/*.sh") if path.name != "common.sh")]
    for script in scripts:
        done = call(project_dir, str(script), "--help")
        assert done.returncode == 0 and "Usage:" in done.stdout and "e.g.:" in done.stdout, script


def test_local_runner_names_the_failing_job(recipe):
    done = call(recipe, "utils/local.sh", "JOB=1:3", "log/x.JOB.log", "bash", "-c", "echo $0; [ $0 != 2 ]", "JOB")
    assert done.returncode == 1
    assert "job 2 failed" in done.stderr and "job 1" not in done.stderr
    assert [(recipe / f"log/x.{n}.log").read_text() for n in (1, 2, 3)] == ["1\n", "2\n", "3\n"]


@pytest.mark.parametrize("script, said", [
    ("kill -KILL $$", "failed by SIGKILL (memory may be short: use a smaller --nj): the log is empty"),
    ("echo begun; kill -TERM $$", "failed by SIGTERM: begun"),
    ("exit 255", "failed: the log is empty: is the disk full?")])
def test_local_runner_names_the_signal_that_ended_a_job(recipe, script, said):
    done = call(recipe, "utils/local.sh", "JOB=1:2", "log/x.JOB.log", "bash", "-c", script)
    assert done.returncode == 1 and f"local.sh: job 1 {said} (log: log/x.1.log)\n" in done.stderr


def test_local_runner_ignores_options_of_schedulers(recipe):
    """As run.pl does: they stay in `cmd` where somebody changes the runner."""
    done = call(recipe, "utils/local.sh", "--mem", "4G", "--num-threads=2", "JOB=1:2", "log/x.JOB.log", "echo", "JOB")
    assert (done.returncode, done.stderr) == (0, "")
    assert [(recipe / f"log/x.{n}.log").read_text() for n in (1, 2)] == ["1\n", "2\n"]


@pytest.mark.parametrize("runner", ["local.sh", "slurm.sh"])
def test_unwritable_log_is_named_and_nothing_starts(recipe, runner):
    (recipe / "log").write_text("not a folder")
    (recipe / "sbatch").symlink_to("/bin/true")
    done = subprocess.run([f"utils/{runner}", "JOB=1:2", "log/x.JOB.log", "touch", "evil"], cwd=recipe, text=True,
                          capture_output=True, env={"PATH": f"{recipe}:{os.environ['PATH']}"}, timeout=60, check=False)
    assert done.returncode == 1 and not (recipe / "evil").exists()
    assert done.stderr == f"{runner}: log log/x.1.log cannot be written: is the disk full or read-only?\n"


@pytest.mark.parametrize("option, value, message", [
    ("--snr", "loud", "must be 'uniform LOW HIGH'"), ("--snr", "20,15", "must be 'uniform LOW HIGH'"),
    ("--point-snr", "$(touch evil)", "must be 'uniform LOW HIGH'"), ("--taps", "512", "must be odd"),
    ("--num-components", "0", "must be at least 1"), ("--split-sizes", "0,0,0", "must be three counts from 1"),
    ("--split-sizes", "9,00,1", "must be three counts from 1"),
    ("--packing", "files", "must be recording or utterance"), ("--test-copies", "0", "must lie in [1, 1000]"),
    ("--t60-range", "0.5", "must be two times"),
    ("--t60-range", "match", "must be two times"), ("--t60-range", "1.2.3,2", "must be two times, as"),
    *(("--t60-range", times, "must be two times in [0.05, 10] s") for times in ("2.0,0.2", "0.01,1", "0.2,11")),
    *((option, "absent", "no such file or directory") for option in (
        "--librispeech", "--reverbdb", "--speech", "--measured", "--dev-rirs", "--test-rirs", "--noises")),
    ("--room-types", "absent.toml", "is of drawn rooms: give --rooms or --free-rooms")])
def test_recipe_refuses_values_before_any_work(project_dir, option, value, message):
    done = call(project_dir, "./run.sh", option, value)
    assert done.returncode == 1 and done.stdout == ""
    colon = ":" * message.startswith("no such")
    assert done.stderr.startswith(f"run.sh: {option} '{value}'{colon} {message}") and done.stderr.count("\n") == 1


@pytest.mark.parametrize("value", ["none", "7", "-2.5", "normal 15 5", "uniform 5, 25", "list 20,15,10"])
def test_recipe_accepts_the_same_snr_as_the_tools(project_dir, value):
    parse_distribution(value, "snr")
    done = call(project_dir, "./run.sh", "--snr", value, "--stop-stage", "99")
    assert done.stderr.startswith("run.sh: --stop-stage '99' ")


@pytest.mark.parametrize("option, low, high, step", [
    ("--num-rays", 100, 10**7, 1), ("--order", 1, 10**4, 1), ("--taps", 3, MAX_TAPS, 2),
    ("--max-effects", 0, len(CATALOGUE), 1), ("--nj", 1, MAX_JOBS, 1)])
def test_recipe_has_the_ranges_of_the_tools(project_dir, option, low, high, step):
    for value in (low - step, high + step):
        done = call(project_dir, "./run.sh", option, str(value), "--data", "/dev/null/data")
        rule = "a whole number" if value < 0 else f"lie in [{low}, {high}]"
        assert done.returncode == 1 and done.stderr.endswith(f"{option} '{value}' must {'be ' * (value < 0)}{rule}\n")
    for value in (low, high):
        options_checked(project_dir, option, str(value))


def options_checked(project_dir, *options):
    """Return what run.sh logs before it finds that its folder cannot be written."""
    done = call(project_dir, "./run.sh", *options, "--data", "/dev/null/data")
    assert done.returncode == 1 and done.stderr.startswith("run.sh: /dev/null/data/.run.lock cannot be written")
    return done.stdout


@pytest.mark.parametrize("value, message", [
    ("absent.toml", "no such file: check the path"),
    ("meeting_room,car", "'car' must be a TOML file or a type in conf/room_types.toml")])
def test_recipe_refuses_unknown_room_types_before_any_work(project_dir, value, message):
    done = call(project_dir, "./run.sh", "--free-rooms", "3", "--room-types", value)
    assert done.returncode == 1 and done.stderr.startswith(f"run.sh: --room-types '{value}': {message}")


def test_recipe_needs_no_corpora_after_stage_0(project_dir):
    options_checked(project_dir, "--stage", "1", "--measured", "absent", "--t60-range", "1,1.")


def test_recipe_finds_too_few_rirs_before_it_simulates(project_dir, tmp_path):
    write_rir_dir(tmp_path / "rirs.real.train", [(row(f"r{n}"), coloured_rir(n)) for n in range(3)])
    done = call(project_dir, "./run.sh", "--stage", "2", "--data", str(tmp_path), "--exp", str(tmp_path / "exp"))
    assert done.returncode == 1 and not (tmp_path / "rirs.sim.train").exists()
    assert done.stderr.startswith(f"enough_rirs.py: {tmp_path}/rirs.real.train: 3 measured RIRs are left after "
                                  "screening of 3: must be at least 7, the mixture's components")


@pytest.mark.parametrize("entry, message", [
    ("absent.wav", "/wav.scp:1: absent.wav: no such audio file"),
    ("sox a.wav -t wav - |", "/wav.scp: audio of s-u is a command, 'sox a.wav -t wav - |', and the recipe runs none"),
    ("{}/8k.wav", "/wav.scp: audio of s-u, {}/8k.wav: sample rate 8000 Hz must be at least 16000 Hz")])
def test_recipe_finds_wrong_speech_before_it_simulates(project_dir, tmp_path, entry, message):
    soundfile.write(tmp_path / "8k.wav", np.ones(8000) / 2, 8000)
    speech = tmp_path / "train.clean"
    speech.mkdir()
    for name, value in {"wav.scp": entry.format(tmp_path), "utt2spk": "s", "text": "HELLO"}.items():
        (speech / name).write_text(f"s-u {value}\n")
    (speech / "spk2utt").write_text("s s-u\n")
    done = call(project_dir, "./run.sh", "--stage", "1", "--data", str(tmp_path), "--exp", str(tmp_path / "exp"))
    assert done.returncode == 1 and "stage 1" not in done.stdout
    assert done.stderr.startswith(f"check_speech.py: {speech}{message.format(tmp_path)}")


@pytest.mark.parametrize("part, audio, message", [
    ("train", "a.wav", ": no text: recognisers need transcripts"),
    ("test", "a.wav", ": no text: recognisers need transcripts"),
    ("train", "48k.wav", "/wav.scp: {}/48k.wav: 48000 Hz, 1 channels, PCM_16: Kaldi's features need 16-bit mono at 16"),
    ("dev", "a.ark:4", "/wav.scp: recording s-u: '{}/a.ark' must be a FLAC or WAV file"),
    ("train", "a.aiff", "/wav.scp: recording s-u: '{}/a.aiff' must be a FLAC or WAV file"),
    ("train", "sphere.wav", "/wav.scp: {}/sphere.wav: format NIST is not that of its name")])
def test_recipe_finds_speech_that_kaldi_cannot_use_before_it_simulates(project_dir, tmp_path, part, audio, message):
    for folder in ("egs/wsj/s5/steps", "egs/wsj/s5/utils", "egs/librispeech/s5/local", "egs/librispeech/s5/conf",
                   "src"):
        (tmp_path / "kaldi" / folder).mkdir(parents=True)
    speech = tmp_path / f"{part}.clean"
    speech.mkdir()
    for name, fs_hz in (("a.wav", 16000), ("48k.wav", 48000), ("a.aiff", 16000)):
        soundfile.write(speech / name, np.linspace(-0.5, 0.5, 160), fs_hz)
    soundfile.write(speech / "sphere.wav", np.linspace(-0.5, 0.5, 160), 16000, "PCM_16", format="NIST")
    (speech / "a.ark").write_bytes(b"s-u " + (speech / "a.wav").read_bytes())
    for name, line in {"wav.scp": f"s-u {speech}/{audio}", "utt2spk": "s-u s", "spk2utt": "s s-u"}.items():
        (speech / name).write_text(f"{line}\n")
    if "no text" not in message:
        (speech / "text").write_text("s-u HI\n")
    done = call(project_dir, "env", f"KALDI_ROOT={tmp_path}/kaldi", "./run.sh", "--stage", "1", "--stop-stage", "8",
                "--data", str(tmp_path), "--exp", str(tmp_path / "exp"))
    assert done.returncode == 1 and "stage 1" not in done.stdout
    assert f"{speech}{message.format(speech)}" in done.stderr


@pytest.mark.parametrize("option", ["--rooms", "--free-rooms"])
def test_recipe_takes_room_types_where_rooms_are_drawn(project_dir, option):
    options_checked(project_dir, "--room-types", "meeting_room", option, "3")


def test_recipe_says_that_drawn_rooms_take_no_t60_range(project_dir):
    line = "--rooms draws all rooms: their T60 is that of the types of rooms, not of --t60-range"
    assert line in options_checked(project_dir, "--t60-range", "0.3,0.5", "--rooms", "3")
    assert line not in options_checked(project_dir, "--t60-range", "0.3,0.5", "--free-rooms", "3")


def test_recipe_takes_its_configurations(project_dir):
    for config in ("digits", "librispeech", "mini", "real_rooms", "smallest"):
        options_checked(project_dir, "--config", f"conf/{config}.conf", "--stage", "9")


def test_recipe_refuses_before_any_work_what_stage_8_would(project_dir):
    """It would be hours later."""
    where = ["--data", "/dev/null/data"]
    done = call(project_dir, "./run.sh", "--stop-stage", "8", *where)
    assert (done.returncode, done.stdout) == (1, "") and done.stderr.startswith("run.sh: KALDI_ROOT is not set: ")
    rows = ["--rows", "clean sim.rvd"]
    done = call(project_dir, "./run.sh", "--stop-stage", "8", *rows, *where)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == ("run.sh: --rows: 'sim.rvd' must be one of: clean real.rvb sim.rvb sim.EQ.rvb "
                           "sim.loop.rvb\n")
    options_checked(project_dir, "--stop-stage", "7", *rows)
    options_checked(project_dir, "--stage", "9", "--rows", "clean sim.free.rvb", "--free-rooms", "3")


@pytest.mark.parametrize("word", ["$(touch evil)", "a;b", "a'b", "a\nb", "é", "*"])
def test_words_are_kept_from_runners_that_let_a_shell_read_them(recipe, word):
    check = '. utils/check_words.sh && check_words log "$0"'
    done = call(recipe, "bash", "-c", f"cmd='queue.pl --mem 2G'; {check}", word)
    assert done.returncode == 1 and "queue.pl would let a shell read" in done.stderr
    assert call(recipe, "bash", "-c", f"cmd=utils/local.sh; {check}", word).returncode == 0


def test_recipe_refuses_another_current_directory(tmp_path, project_dir):
    done = call(tmp_path, str(project_dir / "run.sh"))
    assert done.returncode != 0 and "directory that holds run.sh" in done.stderr


@pytest.mark.parametrize("options, message", [
    (["--lm-text", "absent.txt"], "run.sh: --lm-text 'absent.txt': no such file"),
    (["--decode-opts", "--beem 11"], "decode.sh: unknown option 'beem'"),
    (["--chain-opts", "--layerz 3"], "train_chain.sh: unknown option 'layerz'"),
    (["--exp", "a b"], "run.sh: --exp 'a b': Kaldi's scripts take no blanks")])
def test_recipe_refuses_options_of_kaldi_before_any_work(project_dir, options, message):
    done = call(project_dir, "./run.sh", "--stop-stage", "8", *options, "--data", "/dev/null/data")
    assert (done.returncode, done.stdout) == (1, "") and message in done.stderr


def in_workspace(project_dir, workspace, script, **environment):
    """Run a script with the functions of `local/kaldi/common.sh`, with three jobs."""
    file = workspace.with_name("script.sh")
    file.write_text(f"set -euo pipefail\nnj=3\ndry_run=false\n. ./path.sh\n. utils/parse_options.sh\n"
                    f". local/kaldi/common.sh\nworkspace={workspace}\n{script}\n")
    return subprocess.run(["bash", str(file)], cwd=project_dir, capture_output=True, text=True, timeout=60,
                          env={"PATH": os.environ["PATH"]} | environment)


def test_functions_of_kaldi_scripts_ignore_the_environment(project_dir, tmp_path):
    (tmp_path / "ws").mkdir()
    (tmp_path / "ws/path.sh").write_text("")
    (tmp_path / "precious").write_text("kept")
    done = in_workspace(project_dir, tmp_path / "ws", "once a/b true", outputs=str(tmp_path / "precious"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "precious").is_file() and (tmp_path / "ws/done/a/b").is_file()


@pytest.mark.parametrize("speakers, jobs", [(2, 2), (40, 3)])
def test_kaldi_gets_no_more_jobs_than_there_are_speakers(project_dir, tmp_path, speakers, jobs):
    (tmp_path / "ws/data/dev").mkdir(parents=True)
    (tmp_path / "ws/data/dev/spk2utt").write_text("s u\n" * speakers)
    assert in_workspace(project_dir, tmp_path / "ws", "jobs_for data/dev").stdout == f"{jobs}\n"


@pytest.mark.parametrize("stage, options, message", [
    ("9", ["--gmm-passes", "mono all"],
     "kaldi/settings is of other texts or options (gmm_passes): start with --stage 8"),
    ("9", ["--lm-text", "README.md"], "kaldi/settings is of other texts or options (texts): start with --stage 8"),
    ("10", ["--align-on", "self", "--rows", "sim.rvb"],
     "trained_with is of other texts or options (align_on): start with --stage 9"),
    ("10", ["--chain-opts", "--config=CONF", "--rows", "sim.rvb"],
     "trained_with is of other texts or options (chain_opts): start with --stage 9")])
def test_later_stages_refuse_a_workspace_of_other_options(project_dir, tmp_path, stage, options, message):
    (tmp_path / "data/train.clean").mkdir(parents=True)
    (tmp_path / "data/train.clean/text").write_text("u HELLO\n")
    (tmp_path / "conf").write_text("layers=9\n")
    workspace = tmp_path / "exp/kaldi"
    (workspace / "train.sim.rvb").mkdir(parents=True)
    script = (project_dir / "local/kaldi/train_and_test.sh").read_text()
    head = script[:script.index("# Refuse a later stage")]
    for target, names in (("settings", "texts gmm_passes"),
                          ("train.sim.rvb/trained_with", 'texts gmm_passes "${of_training[@]}"')):
        (tmp_path / "settings.sh").write_text(f"{head}\nsettings {names}\n")
        done = call(project_dir, "bash", str(tmp_path / "settings.sh"), str(tmp_path / "data"), str(tmp_path / "exp"))
        assert done.returncode == 0, done.stderr
        (workspace / target).write_text(done.stdout)
    (workspace / "seed").write_text("0\n")
    options = [word.replace("CONF", str(tmp_path / "conf")) for word in options]
    done = call(project_dir, "local/kaldi/train_and_test.sh", "--stage", stage, *options, str(tmp_path / "data"),
                str(tmp_path / "exp"))
    assert done.returncode == 1 and message in done.stderr, done.stderr


STAND_IN = """#!/usr/bin/env bash
# stands in for Kaldi's train.py: makes examples and models, removes examples and the first models, then writes reports
set -euo pipefail
echo "${@: -1}" >>stages
cd train.sim
mkdir -p egs
stage=${@: -1}
if [ "$stage" -le -3 ]; then touch egs/cegs.{1,2}.ark; fi
if [ "$stage" -le 4 ]; then
  touch {0,1,2,3,4}.mdl
  [ -e egs/cegs.1.ark ]
  [ "$(cat ../killed_at)" != models ]
  touch final.mdl
fi
rm -f egs/cegs.1.ark
[ "$(cat ../killed_at)" != cleaning ]
rm -f egs/cegs.2.ark {1,2}.mdl
[ "$(cat ../killed_at)" != reports ]
"""


@pytest.mark.parametrize("killed_at, stage", [("models", "3"), ("cleaning", "1000000"), ("reports", "1000000")])
def test_training_goes_on_where_it_was_killed(project_dir, tmp_path, killed_at, stage):
    """Kaldi's train.py removes the examples before its reports: a training that has none left is not repeated."""
    workspace = tmp_path / "ws"
    for name in ("done/train.sim/features/train.sim.hires.fix", "done/train.clean/align/tree"):
        (workspace / name).parent.mkdir(parents=True)
        (workspace / name).write_text("key\n")
    for folder in ("train.sim", "data/train.sim", "data/train.sim.hires", "bin"):
        (workspace / folder).mkdir(parents=True, exist_ok=True)
    for name in ("data/train.sim/source", "data/train.sim.hires/text", "data/train.sim.hires/spk2utt"):
        (workspace / name).write_text("a\n")
    for name, script in (("steps/nnet3/chain/train.py", STAND_IN), ("bin/tree-info", "#!/bin/sh\necho num-pdfs 9\n"),
                         ("steps/nnet3/xconfig_to_configs.py", "#!/bin/sh\n")):
        (workspace / name).parent.mkdir(parents=True, exist_ok=True)
        (workspace / name).write_text(script)
        (workspace / name).chmod(0o755)
    (workspace / "path.sh").write_text("export PATH=$PWD/bin:$PATH\n")
    for moment in (killed_at, "never", "never"):
        (workspace / "killed_at").write_text(moment)
        done = call(project_dir, "local/kaldi/train_chain.sh", "--ivectors", "false", str(workspace),
                    "train.sim", "train.clean")
        assert done.returncode == (moment == killed_at), done.stderr
    assert (workspace / "stages").read_text().split() == ["-10", stage]


@pytest.mark.parametrize("step, n_inputs", [("characterise_rirs.sh", 1), ("fit_eq.sh", 2), ("close_loop.sh", 2)])
def test_logs_of_two_outputs_are_apart(step, n_inputs, project_dir, tmp_path):
    """Both may be made at a time; close_loop.sh prints what its log says."""
    write_rir_dir(tmp_path / "rirs", [(row("a"), coloured_rir(1))])
    (tmp_path / "runner").write_text(f'#!/bin/sh\nfor word; do case $word in *.log) echo "$word" >>{tmp_path}/logs; '
                                     "esac; done\nexit 1\n")
    (tmp_path / "runner").chmod(0o755)
    for name in ("a", "b"):
        subprocess.run([f"steps/{step}", *[f"{tmp_path}/rirs"] * n_inputs, f"{tmp_path}/{name}"], cwd=project_dir,
                       env={"PATH": os.environ["PATH"], "cmd": f"{tmp_path}/runner"}, timeout=60)
    logs = (tmp_path / "logs").read_text().split()
    assert len(logs) == len(set(logs)) == 2
