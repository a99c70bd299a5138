"""Directories that were made of others than the present ones, or with other seeds, are refused."""

import pytest
from scripts import call

import check_origin
from roomeq.core.build import Build
from roomeq.core.files import write_text


def make(out, step, *inputs, **options):
    """Make a directory as a step does."""
    build = Build(out, step=step, options=options, inputs=list(inputs))
    if not build.done and build.run({}, lambda *_: None):
        build.finish(lambda directory, _: write_text(directory / "model.json", f"{step} {options}"))


@pytest.fixture
def run(tmp_path):
    """Make what stages 1 to 6 make; return the function that runs one stage again."""
    def stage(number, seed=0, **options):
        data, exp = tmp_path / "data", tmp_path / "exp"
        real, sim, loop = data / "rirs.real.train", data / "rirs.sim.train", exp / "loop"
        calls = {1: [(real, "split", data / "rirs.real")], 2: [(sim, "simulate", real)],
                 3: [(exp / "eq", "fit-eq", real, sim)],
                 4: [(data / "rirs.sim.EQ.train", "compensate", sim, exp / "eq")],
                 5: [(loop, "close-loop", real), (data / "rirs.sim.loop.train", "simulate", real, loop / "model.json")],
                 6: [(data / f"train.{kind}.rvb", "augment", data / "train.clean", data / f"rirs.{kind}.train", real)
                     for kind in ("real", "sim")]}
        for made in calls[number]:
            make(*made, seed=seed, **options)

    make(tmp_path / "data/rirs.real", "characterise")
    make(tmp_path / "data/train.clean", "prepare-speech")
    for number in range(1, 7):
        stage(number)
    return stage


def refused(tmp_path, capsys, *options):
    """Return what is said; nothing if the directories are taken."""
    status = check_origin.main([*options, str(tmp_path / "data"), str(tmp_path / "exp")])
    said = capsys.readouterr().err
    assert status == bool(said)
    return said


@pytest.mark.parametrize("changed, name, made_of, first", [
    (1, "data/rirs.sim.train", "rirs.real.train", 2), (2, "exp/eq", "rirs.sim.train", 3),
    (3, "data/rirs.sim.EQ.train", "eq", 4), (5, "data/rirs.sim.loop.train", "model.json", 5)])
def test_stage_repeated_alone_is_followed_by_the_next(run, tmp_path, capsys, changed, name, made_of, first):
    assert refused(tmp_path, capsys, "--seed", "0", "--speech") == ""
    if changed == 5:
        make(tmp_path / "exp/loop", "close-loop", tmp_path / "data/rirs.real.train", max_effects=1)
    else:
        run(changed, order=1)
    said = refused(tmp_path, capsys, "--seed", "0")
    assert f"{name}: was made of another {made_of} than the present one: start with --stage {first}, or " in said
    for number in range(first, 6):
        run(number, **dict(order=1) if changed == 2 else {})
    assert refused(tmp_path, capsys, "--seed", "0") == ""


def test_kinds_that_are_not_used_are_not_checked(run, tmp_path, capsys):
    run(5, seed=3)
    assert "was made with seed 3, not 0: start with --stage 5" in refused(tmp_path, capsys, "--seed", "0")
    assert refused(tmp_path, capsys, "--seed", "0", "--kinds", "real,sim,sim.EQ") == ""


def test_far_field_speech_is_of_the_present_rirs(run, tmp_path, capsys):
    for number in range(2, 6):
        run(number, seed=1)
    assert refused(tmp_path, capsys) == ""
    assert "train.sim.rvb: was made of another rirs.sim.train than the present one: start with --stage 6" in \
        refused(tmp_path, capsys, "--speech")


def test_effects_are_compared_with_rirs_of_the_same_options(run, tmp_path, capsys):
    """As where a run is resumed at stage 5 without its configuration."""
    run(5, num_rays=500)
    assert ("rirs.sim.loop.train: was made with other options than rirs.sim.train (num_rays 500, not None): start "
            "with --stage 5, or ") in refused(tmp_path, capsys, "--seed", "0")
    for number in range(2, 6):
        run(number, num_rays=500)
    assert refused(tmp_path, capsys, "--seed", "0") == ""
    run(5, num_rays=500, draw_devices=True)  # of a model, which the other RIRs lack
    assert refused(tmp_path, capsys, "--seed", "0") == ""


def test_far_field_speech_of_all_kinds_is_of_the_same_options(run, tmp_path, capsys):
    """As where stage 6 was stopped after the first kind."""
    make(tmp_path / "data/train.real.rvb", "augment", tmp_path / "data/train.clean",
         *[tmp_path / "data/rirs.real.train"] * 2, seed=0, snr_db="none")
    assert ("train.sim.rvb: was made with other options than train.real.rvb (snr_db None, not none): start with "
            "--stage 6, or ") in refused(tmp_path, capsys, "--speech")
    run(6, snr_db="none")
    assert refused(tmp_path, capsys, "--speech") == ""


def test_seeds_may_share_a_split(run, tmp_path, capsys):
    said = refused(tmp_path, capsys, "--seed", "1")
    assert "rirs.sim.train: was made with seed 0, not 1: start with --stage 2" in said
    for number in range(2, 6):
        run(number, seed=1)
    assert refused(tmp_path, capsys, "--seed", "1") == ""


def test_directory_without_a_stamp_is_taken(run, tmp_path, capsys):
    run(1, order=1)
    (tmp_path / "data/rirs.real.train/.done").unlink()
    assert refused(tmp_path, capsys, "--seed", "0") == ""


def test_input_that_is_gone_is_no_mixture(run, tmp_path, capsys):
    (tmp_path / "data/rirs.real.train/model.json").write_text("damaged")
    (tmp_path / "data/rirs.real").rename(tmp_path / "elsewhere")
    assert refused(tmp_path, capsys, "--seed", "0") == ""


def test_recipe_takes_no_rirs_of_another_seed(run, tmp_path, project_dir):
    (tmp_path / "data/rirs.real.train").rename(tmp_path / "elsewhere")  # it holds no RIRs
    done = call(project_dir, "./run.sh", "--data", f"{tmp_path}/data", "--exp", f"{tmp_path}/exp", "--seed", "1",
                "--stage", "6")
    assert done.returncode == 1 and "stage 6" not in done.stdout
    assert done.stderr == (f"check_origin.py: {tmp_path}/data/rirs.sim.train: was made with seed 0, not 1: start with "
                           f"--stage 2, or remove {tmp_path}/data/rirs.sim.train/.done to use it as it is\n")
