"""The Kaldi stages: the commands, their order, and which of them run again after a change."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest
import recipe_run
from datadirs import speech_dir

from roomeq.core.audio import write_wav
from roomeq.core.digests import digest
from roomeq.core.files import write_json, write_text
from roomeq.core.stamps import FORMAT, stamp_content

ONCE = """#!/usr/bin/env bash
# Count.
# Usage: count.sh [options] <workspace> <word>
set -euo pipefail
nj=2            # jobs
dry_run=false   # print
input=          # file
. utils/parse_options.sh
. local/kaldi/common.sh
workspace=$1
[ -z "$input" ] || inputs "$input"
once first sh -c 'echo "$3" >>count' count --nj "$nj" "$2"
once second sh -c 'echo "$1" >>count; [ "$1" != bad ] || { echo "it went wrong"; exit 3; }' count "$2"
"""


def run(where, *args, **environment):
    """Run a command in a minimal environment without KALDI_ROOT, with `environment` added."""
    return subprocess.run(args, cwd=where, capture_output=True, text=True, timeout=1200,
                          env={"PATH": os.environ["PATH"]} | environment)


def dry(project_dir, tmp_path, *options):
    """Return the commands that a dry run of stages 8-10 prints."""
    done = run(project_dir, "./run.sh", "--data", f"{tmp_path}/data", "--exp", f"{tmp_path}/exp", "--dry-run", *options)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir())
    return done.stdout.splitlines()


def position(lines, *patterns):
    """Return the index of the first line that matches all patterns."""
    return next(k for k, line in enumerate(lines) if all(re.search(pattern, line) for pattern in patterns))


def test_dry_run_needs_neither_kaldi_nor_data(project_dir, tmp_path):
    lines = dry(project_dir, tmp_path, "--stage", "8")
    order = [position(lines, "copy_data", "train.sim.loop.rvb"), position(lines, "make_lms.py"),
             position(lines, "train_mono"), position(lines, "train_sat"), position(lines, "get_prons"),
             position(lines, "build_const_arpa_lm", "fglarge"), position(lines, "align_fmllr_lats"),
             position(lines, "chain/train.py", "--dir train.sim.EQ.rvb"),
             position(lines, "nnet3/decode", "train.sim.rvb/decode_dev.sim.rvb_tgsmall"),
             position(lines, "online/nnet3/decode", "train.sim.loop.rvb/online/decode_test.real.rvb")]
    assert order == sorted(order)
    trained = [line for line in lines if "chain/train.py" in line]
    assert len(trained) == 5
    assert all("--use-gpu no" in line and "--tree-dir train.clean/align/tree" in line for line in trained)
    assert all("--feat.cmvn-opts=--config=conf/online_cmvn.conf" in line and "--online-cmvn\\ true" in line
               for line in trained)
    assert not any("ivectors" in line or "sim.free" in line for line in lines)
    position(lines, "modify_speaker_info.sh --utts-per-spk-max 1 data/test.real.rvb data/test.real.rvb.hires")
    decoded = [line for line in lines if re.match(r"steps/(nnet3/decode|lmrescore|online/nnet3/decode)", line)]
    assert len(decoded) == 5 * 2 * 5  # sets, test sets, language models and online


def test_free_rooms_add_a_row(project_dir, tmp_path):
    lines = dry(project_dir, tmp_path, "--stage", "8", "--free-rooms", "10")
    position(lines, "chain/train.py", "--dir train.sim.free.rvb")
    lines = dry(project_dir, tmp_path, "--stage", "8", "--free-rooms", "10", "--rooms", "10")
    assert "no set sim.free" in lines[0] and not any("train.sim.free" in line for line in lines)


def test_rows_selects_the_systems_to_train(project_dir, tmp_path):
    lines = dry(project_dir, tmp_path, "--stage", "8", "--rows", "real.rvb sim.loop.rvb")
    trained = [line for line in lines if "chain/train.py" in line]
    assert [re.search("--dir (\\S+)", line)[1] for line in trained] == ["train.real.rvb", "train.sim.loop.rvb"]
    position(lines, "train_sat", "data/train.clean ")


def test_a_later_stage_does_not_repeat_earlier_ones(project_dir, tmp_path):
    assert not any("train.py" in line for line in dry(project_dir, tmp_path, "--stage", "10"))
    assert not any("mono" in line for line in dry(project_dir, tmp_path, "--stage", "9"))


def test_librispeech_config_runs_the_stock_recipe(project_dir, tmp_path):
    lines = dry(project_dir, tmp_path, "--stage", "8", "--config", "conf/librispeech.conf", "--librispeech", "LS")
    position(lines, "download_lm.sh")
    position(lines, "prepare_dict.sh")
    for name in ("train.clean", "train.real.rvb", "train.sim.rvb"):
        position(lines, "train_sat.sh", "5000 100000", f"data/{name} ")
        position(lines, "perturb_data_dir_speed_3way", f"data/{name} ")
        position(lines, "build_tree", "7000", f"{name}/align/tree")
        position(lines, "extract_ivectors_online", f"{name}/ivectors/test.real.rvb")
        position(lines, "chain/train.py", "--use-gpu wait", f"--tree-dir {name}/align/tree",
                 f"--feat.online-ivector-dir {name}/ivectors/{name}", "--trainer.num-epochs 4")
        position(lines, "prepare_online_decoding", f"{name}/ivectors/extractor")


@pytest.mark.parametrize("options, words", [
    (["--dry-run"], ["--dry-run", "add --stage 8"]),
    (["--stage", "8", "--dry-run", "--stop-stage", "10", "--align-on", "them"], ["--align-on 'them'", "clean or self"]),
    (["--stage", "8", "--dry-run", "--rows", "sim.rvb sim.rvd"], ["--rows: 'sim.rvd'", "clean real.rvb sim.rvb"]),
    (["--stage", "8", "--dry-run", "--stop-stage", "10", "--gmm-passes", "mono ten, deltas all 300 3000"],
     ["'mono ten, deltas all 300 3000'", "kind, utterances, leaves"]),
    (["--stage", "8", "--dry-run", "--stop-stage", "10", "--gmm-passes", "quad 3"],
     ["'quad 3'", "kind, utterances, leaves"]),
])
def test_wrong_kaldi_options_are_refused_in_one_line(project_dir, options, words):
    done = run(project_dir, "./run.sh", *options)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert all(word in last for word in words)


@pytest.fixture
def recipe(tmp_path, project_dir):
    """A directory with the recipe's utils and local, and one small script."""
    for name in ("utils", "local", "cmd.sh"):
        (tmp_path / name).symlink_to(project_dir / name)
    (tmp_path / "count.sh").write_text(ONCE)
    (tmp_path / "count.sh").chmod(0o755)
    (tmp_path / "ws").mkdir()
    (tmp_path / "ws/path.sh").write_text("")
    return tmp_path


def counted(recipe, *args, fails=False):
    """Run the small script; return its counts so far and its stderr."""
    done = run(recipe, "./count.sh", *args)
    assert done.returncode == (1 if fails else 0), done.stderr
    return (recipe / "ws/count").read_text().split(), done.stderr


def test_once_repeats_only_after_a_change(recipe):
    assert counted(recipe, "ws", "a")[0] == ["a", "a"]
    assert counted(recipe, "ws", "a")[0] == ["a", "a"]
    assert counted(recipe, "--nj", "5", "ws", "a")[0] == ["a", "a"]
    assert counted(recipe, "ws", "b")[0] == ["a", "a", "b", "b"]
    (recipe / "in").write_text("1")
    assert len(counted(recipe, "--input", "in", "ws", "b")[0]) == 6
    (recipe / "in").write_text("2")
    assert len(counted(recipe, "--input", "in", "ws", "b")[0]) == 8


@pytest.fixture
def stubs(recipe):
    """A function that runs a script of local/kaldi with Kaldi's scripts replaced by ones that do nothing."""
    for name in ("steps/make_mfcc.sh", "steps/compute_cmvn_stats.sh", "utils/fix_data_dir.sh",
                 "utils/copy_data_dir.sh"):
        write_text(recipe / "ws" / name, "#!/bin/sh\n")
        (recipe / "ws" / name).chmod(0o755)
    (recipe / "path.sh").write_text("")
    for name in ("conf/mfcc.conf", "conf/mfcc_hires.conf", "data/a/source", "data/a/spk2utt", "data/a.hires/spk2utt"):
        write_text(recipe / "ws" / name, "")

    def started(script, *args):
        done = run(recipe, f"local/kaldi/{script}.sh", *args)
        assert done.returncode == 0, done.stderr
        return re.findall(r"kaldi: (.*)", done.stdout)

    return started


@pytest.mark.parametrize("hires, config", [("false", "mfcc.conf"), ("true", "mfcc_hires.conf")])
def test_features_are_made_again_after_a_change_of_their_configuration(recipe, stubs, hires, config):
    made = "a.hires" if hires == "true" else "a"
    again = [f"a/features/{made}", f"a/features/{made}.cmvn", f"a/features/{made}.fix"]
    assert stubs("make_features", "--hires", hires, "ws", "a")[-3:] == again
    assert stubs("make_features", "--hires", hires, "ws", "a") == []
    (recipe / "ws/conf" / config).write_text("--num-ceps=20\n")
    assert stubs("make_features", "--hires", hires, "ws", "a") == again


def test_commands_after_one_that_has_run_since_are_repeated(recipe):
    """What a later command made lay in the directory that the earlier one has made again."""
    counted(recipe, "ws", "a")
    assert counted(recipe, "ws", "bad", fails=True)[0] == ["a", "a", "bad", "bad"]
    (recipe / "ws/done/first").unlink()
    assert counted(recipe, "ws", "bad", fails=True)[0][4:] == ["bad", "bad"]
    assert counted(recipe, "ws", "a")[0][6:] == ["a", "a"]
    (recipe / "ws/done/first").unlink()
    assert counted(recipe, "ws", "a")[0][8:] == ["a", "a"]
    assert len(counted(recipe, "ws", "a")[0]) == 10


def test_workspace_that_was_moved_is_begun_anew(recipe, project_dir):
    """Kaldi names features by absolute paths, where another workspace may be now."""
    (recipe / "path.sh").write_text("")
    kaldi = fake_kaldi(recipe / "kaldi")

    def made():
        done = run(recipe, "local/kaldi/make_workspace.sh", "ws", "data", KALDI_ROOT=str(kaldi))
        assert "not found:" in done.stderr  # Kaldi's programs, after the rest
        (recipe / "ws/path.sh").write_text("")
        return done.stdout

    assert "was made as" not in made() + made()
    counted(recipe, "ws", "a")
    write_text(recipe / "ws/place", f"{recipe}/elsewhere\n")
    assert f"ws was made as {recipe}/elsewhere, by which Kaldi names its features: start with --stage 8" in \
        counted(recipe, "ws", "b", fails=True)[1]
    assert "commands run again" in made()
    assert counted(recipe, "ws", "b")[0] == ["a", "a", "b", "b"]


def test_command_whose_output_was_deleted_is_repeated(recipe):
    command = """once first sh -c 'mkdir -p "$1" && echo a >>count' make "out/it's one\""""
    (recipe / "make.sh").write_text(ONCE.replace("once first", f"{command}\nonce third"))
    (recipe / "make.sh").chmod(0o755)
    for _ in range(2):
        assert run(recipe, "./make.sh", "ws", "b").returncode == 0
        assert (recipe / "ws/count").read_text().split() == ["a", "b", "b"]
    shutil.rmtree(recipe / "ws/out")
    assert run(recipe, "./make.sh", "ws", "b").returncode == 0
    assert (recipe / "ws/out/it's one").is_dir()
    assert (recipe / "ws/count").read_text().split() == ["a", "b", "b"] * 2


def test_outputs_of_an_earlier_run_with_more_jobs_are_removed(recipe):
    (recipe / "ws/out").mkdir()
    for name in ("lat.1.gz", "lat.9.gz", "kept"):
        (recipe / "ws/out" / name).write_text("")
    (recipe / "clear.sh").write_text(ONCE.replace("once first", "outputs=out/lat.*.gz once first"))
    (recipe / "clear.sh").chmod(0o755)
    assert run(recipe, "./clear.sh", "ws", "a").returncode == 0
    assert [path.name for path in (recipe / "ws/out").iterdir()] == ["kept"]


def test_failed_command_is_named_and_alone_repeated(recipe):
    _, said = counted(recipe, "ws", "bad", fails=True)
    assert "second failed" in said and "it went wrong" in said and "ws/log/second.log" in said
    assert counted(recipe, "ws", "bad", fails=True)[0] == ["bad"] * 3


def test_commands_left_by_a_killed_run_are_waited_for(recipe):
    command = "exec 9>ws/.lock; flock 9; echo held; sleep 12; echo a >>ws/count"
    left = subprocess.Popen(["sh", "-c", command], cwd=recipe, stdout=subprocess.PIPE)
    left.stdout.readline()
    done = run(recipe, "./count.sh", "ws", "b")
    assert left.wait() == 0 and done.returncode == 0
    assert "kaldi: waiting for a command of another run in ws" in done.stdout
    assert (recipe / "ws/count").read_text().split() == ["a", "b", "b"]


def test_two_simultaneous_runs_do_each_command_once(recipe):
    runs = [subprocess.Popen(["./count.sh", "ws", "a"], cwd=recipe) for _ in range(2)]
    assert [process.wait() for process in runs] == [0, 0]
    assert (recipe / "ws/count").read_text().split() == ["a", "a"]


def test_missing_input_is_named(recipe):
    done = run(recipe, "./count.sh", "--input", "gone", "ws", "a")
    assert (done.returncode, done.stdout) == (1, "")
    assert "gone is missing" in done.stderr


@pytest.fixture
def copy_data(project_dir):
    """A function that runs local/kaldi/copy_data.py."""
    return lambda *args: run(project_dir, str(project_dir / ".venv/bin/python"), "local/kaldi/copy_data.py",
                             *map(str, args), PYTHONPATH=str(project_dir / "pysrc"), LC_ALL="C")


def test_copied_directory_names_audio_by_absolute_paths(copy_data, tmp_path, project_dir):
    source = speech_dir(tmp_path / "a dir")
    relative = os.path.relpath(source, project_dir)
    done = copy_data(relative, tmp_path / "copy")
    assert done.returncode == 0, done.stderr
    for line in (tmp_path / "copy/wav.scp").read_text().splitlines():
        assert f"'{tmp_path}/a dir/" in line
    assert (tmp_path / "copy/text").read_bytes() == (source / "text").read_bytes()


def test_names_of_wav_files_are_quoted_for_scripts_that_paste_them_into_commands(copy_data, tmp_path):
    names = ["plain.wav", "a;touch evil;.wav"]
    for name in names:
        write_wav(tmp_path / name, np.full(1600, 0.1))
    (tmp_path / "source").mkdir()
    for table, line in (("wav.scp", "u{n} {path}"), ("text", "u{n} YES"), ("utt2spk", "u{n} u{n}")):
        (tmp_path / "source" / table).write_text("".join(
            line.format(n=n, path=tmp_path / name) + "\n" for n, name in enumerate(names)))
    done = copy_data(tmp_path / "source", tmp_path / "copy")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "copy/wav.scp").read_text() == (
        f"u0 {tmp_path}/plain.wav\nu1 cat '{tmp_path}/a;touch evil;.wav' |\n")


def test_copy_keeps_features_until_the_source_changes(copy_data, tmp_path):
    source, copy = speech_dir(tmp_path / "source"), tmp_path / "ws/data/a"
    features, mark = copy / "feats.scp", tmp_path / "ws/done/a/features/a.cmvn"
    copy_data(source, copy)
    for path in (features, mark):
        write_text(path, "x")
    copy_data(source, copy)
    assert features.exists() and mark.exists()
    write_json(source / ".done", stamp_content(step="augment", key="k", options={}, files={}, format=FORMAT))
    assert copy_data(source, copy).returncode == 0
    assert not features.exists() and not mark.exists()


def test_far_field_speech_of_another_seed_is_refused(copy_data, tmp_path):
    source = speech_dir(tmp_path / "source")
    write_json(source / ".done", stamp_content(step="augment", key="k", options=dict(seed=0), files={}, format=FORMAT))
    assert copy_data("--seed", "0", source, tmp_path / "ws/data/a").returncode == 0
    done = copy_data("--seed", "1", source, tmp_path / "ws/data/b")
    assert done.returncode == 1 and "was made with seed 0, and would count as one of seed 1" in done.stderr


def test_copy_states_the_content_of_a_set_that_a_step_made(copy_data, tmp_path):
    source, copy = speech_dir(tmp_path / "source"), tmp_path / "ws/data/a"
    assert copy_data(source, copy).returncode == 0 and not (copy / "content").exists()
    write_json(source / ".done", stamp_content(step="augment", key="k", options={}, files={}, format=FORMAT))
    assert copy_data(source, copy).returncode == 0
    assert (copy / "content").read_text() == f"{digest(source)}\n"
    (copy / "content").unlink()  # of an earlier version
    assert copy_data(source, copy).returncode == 0
    assert (copy / "content").read_text() == f"{digest(source)}\n"


def test_copy_refuses_pipes(copy_data, tmp_path):
    source = speech_dir(tmp_path / "source")
    (source / "wav.scp").write_text("".join(
        f"{line.split()[0]} sox in.wav -t wav - |\n" for line in (source / "wav.scp").read_text().splitlines()))
    done = copy_data(source, tmp_path / "copy")
    assert done.returncode == 1
    assert "must be a FLAC or WAV file" in done.stderr
    assert not (tmp_path / "copy").exists()


def fake_kaldi(root):
    """Make the folders of a Kaldi checkout without compiled programs."""
    for folder in ("egs/wsj/s5/steps", "egs/wsj/s5/utils", "egs/librispeech/s5/local", "egs/librispeech/s5/conf",
                   "src/featbin"):
        (root / folder).mkdir(parents=True)
    return root


def test_missing_kaldi_root_is_named(recipe, project_dir):
    (recipe / "path.sh").write_text("")
    done = run(recipe, "local/kaldi/make_workspace.sh", "ws", "data")
    assert done.returncode == 1
    assert done.stderr == ("make_workspace.sh: KALDI_ROOT is not set: set it to Kaldi's top directory, or put this "
                           "directory into Kaldi's egs/librispeech\n")


def test_wrong_kaldi_root_is_named(recipe, tmp_path):
    (recipe / "path.sh").write_text("")
    done = run(recipe, "local/kaldi/make_workspace.sh", "ws", "data", KALDI_ROOT=str(tmp_path))
    assert done.returncode == 1
    assert f"KALDI_ROOT '{tmp_path}' has no egs/wsj/s5/steps" in done.stderr


def test_kaldi_root_is_found_from_egs_librispeech(tmp_path, project_dir):
    kaldi = fake_kaldi(tmp_path / "kal di")
    inside = kaldi / "egs/librispeech/rooms"
    inside.symlink_to(project_dir)
    done = run(inside, "bash", "-c", 'cd "$0" && local/kaldi/make_workspace.sh "$1" data', str(inside),
               str(tmp_path / "ws"))
    assert done.returncode == 1
    assert "not found:" in done.stderr and "compute-mfcc-feats" in done.stderr
    assert f"{kaldi}/src" in done.stderr
    assert (tmp_path / "ws/steps").resolve() == kaldi / "egs/wsj/s5/steps"


def put_programs(folder, **programs):
    """Write shell scripts in place of programs; `_` in a name stands for a hyphen."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, script in programs.items():
        path = folder / name.replace("_", "-")
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)


@pytest.fixture
def workspace(recipe, tmp_path):
    """A workspace with a Kaldi whose programs do nothing, and an OpenFst that takes `--project_output`."""
    (recipe / "path.sh").write_text("")
    bin_dir = tmp_path / "programs"
    put_programs(bin_dir, **dict.fromkeys((
        "flac", "sox", "fsttablecompose", "compute_mfcc_feats", "gmm_est_fmllr", "gmm_est_fmllr_gpost",
        "chain_est_phone_lm", "nnet_get_feature_transform", "nnet3_chain_train", "nnet3_latgen_faster",
        "lattice_lmrescore_const_arpa", "online2_wav_nnet3_latgen_faster", "compute_wer_bootci"), "exit 0"),
        arpa2fst='echo "LOG (arpa2fst[5.5.1-abcd]:Read():a.cc:94) Reading" >&2', fstcompile="cat", fstprint="cat",
        fstproject='[ "$1" = --project_output=true ] && echo 0 1 2 2')
    (recipe / "ws/path.sh").write_text(f"export KALDI_ROOT=/kaldi; PATH=$PWD/bin:{bin_dir}:$PATH\n")
    return recipe, bin_dir


def test_kaldi_version_is_kept(workspace):
    recipe, _ = workspace
    done = run(recipe, "local/kaldi/check_kaldi.sh", "ws")
    assert done.returncode == 0, done.stderr
    assert (recipe / "ws/kaldi_version").read_text() == "5.5.1-abcd\n"
    assert not (recipe / "ws/bin").exists()


def test_option_that_fstproject_does_not_know_is_translated(workspace):
    recipe, bin_dir = workspace
    put_programs(bin_dir, fstproject='[ "$1" = --project_type=output ] && echo 0 1 2 2 || exit 1')
    done = run(recipe, "local/kaldi/check_kaldi.sh", "ws")
    assert done.returncode == 0 and "the workspace translates it" in done.stdout
    translated = run(recipe / "ws", "bash", "-c", ". ./path.sh && fstproject --project_output=true")
    assert translated.stdout == "0 1 2 2\n"
    put_programs(bin_dir, fstproject='[ "$1" = --project_output=true ] && echo 0 1 2 2')
    assert run(recipe, "local/kaldi/check_kaldi.sh", "ws").returncode == 0
    assert not (recipe / "ws/bin/fstproject").exists()


@pytest.mark.parametrize(("programs", "words"), [
    (dict(fstproject="echo unknown flag >&2; exit 1"), ["projects neither", "unknown flag", "tools/Makefile"]),
    (dict(arpa2fst="echo about to crash >&2; kill -SEGV $$"), ["arpa2fst fails", "139", "about to crash"])])
def test_unusable_openfst_is_refused(workspace, programs, words):
    recipe, bin_dir = workspace
    put_programs(bin_dir, **programs)
    done = run(recipe, "local/kaldi/check_kaldi.sh", "ws")
    assert done.returncode == 1
    assert all(word in done.stderr.splitlines()[-1] for word in words), done.stderr


@pytest.mark.skipif("KALDI_ROOT" not in os.environ, reason="needs KALDI_ROOT: Kaldi, compiled")
def test_stock_kaldi_trains_and_decodes(tmp_path, project_dir):
    """Stages 8-10 at the smallest size: every stock command runs, and the table is made."""
    recipe_run.finish(recipe_run.start(project_dir, tmp_path, tmp_path / "corpora", 2, "--stop-stage", "6"))
    small = ["--gmm-passes", "mono all, deltas all 50 300, sat all 50 300", "--num-leaves", "50", "--chain-opts",
             "--layers 2 --dim 48 --bottleneck 8 --epochs 1 --jobs-initial 1 --jobs-final 1 --chunk-width 60,40 "
             "--minibatch 8,4,2,1", "--decode-opts", "--beam 6 --max-active 300"]

    def stages(first, last):
        return recipe_run.finish(recipe_run.start(project_dir, tmp_path, tmp_path / "corpora", 2, *small, "--stage",
                                                  str(first), "--stop-stage", str(last)))

    stages(8, 10)
    for name in ("train.clean", "train.sim.rvb", "test.real.rvb"):
        checked = run(tmp_path / "exp/kaldi", "bash", "-c", '. ./path.sh && utils/validate_data_dir.sh "$0"',
                      f"data/{name}.hires")
        assert checked.returncode == 0, checked.stderr
    assert (tmp_path / "exp/wer/wer.json").exists()
    assert " kaldi: " not in stages(8, 9)


@pytest.mark.skipif("KALDI_ROOT" not in os.environ, reason="needs KALDI_ROOT: Kaldi, compiled")
def test_features_are_those_of_the_set_and_the_options(tmp_path, project_dir):
    source, ws = tmp_path / "data/a", tmp_path / "ws"

    def copied(state):
        shutil.rmtree(source, ignore_errors=True)
        speech_dir(source, {f"{speaker}-{n}": 16000 for speaker in "ab" for n in range(3)}, seed=state)
        write_json(source / ".done", stamp_content(step="augment", key=str(state), options={}, files={}, format=FORMAT))
        done = run(project_dir, "local/kaldi/make_workspace.sh", str(ws), str(source),
                   KALDI_ROOT=os.environ["KALDI_ROOT"])
        assert done.returncode == 0, done.stderr

    def featured(made, *options):
        done = run(project_dir, "local/kaldi/make_features.sh", *options, str(ws), "a",
                   KALDI_ROOT=os.environ["KALDI_ROOT"])
        assert done.returncode == 0, done.stderr
        return done.stdout, (ws / "data" / made / "feats.scp").read_text()

    copied(0)
    said, _ = featured("a.sp", "--speed-perturb", "true")
    assert "features/speed" in said and featured("a.sp", "--speed-perturb", "true")[0] == ""
    for by_utterance in ("false", "true", "false"):
        said, _ = featured("a.hires", "--hires", "true", "--by-utterance", by_utterance)
        assert "features/a.hires.cmvn" in said
        assert len((ws / "data/a.hires/spk2utt").read_text().splitlines()) == (6 if by_utterance == "true" else 2)
    copied(1)  # and killed before its features
    copied(0)
    assert "features/speed" in featured("a.sp", "--speed-perturb", "true")[0]
