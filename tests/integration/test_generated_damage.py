"""Damage between two steps, drawn by number, and losses of power at any place of a step: never other results."""

import random

import pytest
from crash_replay import Disk, disk_after
from generated_damage import CASES, RECIPE, World
from pipeline import SYNTHETIC
from power_losses import AUDIO_STEPS, Losses

N_EXAMPLES = 50
STRIDE = 41
"""Step between examples: all places in turn, and the kinds of damage too."""
STEPS = {step.name: step for step in RECIPE}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    root = tmp_path_factory.mktemp("world")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        yield World(root)


def test_examples_reach_every_step_place_and_kind():
    cases = [CASES[number * STRIDE % len(CASES)] for number in range(N_EXAMPLES)]
    for n in range(3):
        assert {case[n] for case in cases} == {case[n] for case in CASES}


@pytest.mark.parametrize("number", range(0, N_EXAMPLES * STRIDE, STRIDE))
def test_damaged_file_is_made_again_or_named(number, world):
    example = world.example(number)
    assert example.ok, example


@pytest.mark.parametrize("name, over_older", [*((name, False) for name in AUDIO_STEPS), ("augment sim", True)])
def test_step_goes_on_after_a_loss_of_power(name, over_older, world):
    rng, losses = random.Random(name), Losses(world, STEPS[name], over_older)
    for kept, number in (("nothing", 3), ("names", 5), ("some", 3)):
        for example in losses.examples(kept, number, rng):
            assert example.outcome == "same bytes", example


@pytest.mark.parametrize("step", SYNTHETIC, ids=lambda step: step.name)
def test_synthetic_corpus_is_whole_after_a_loss_of_power(step, tmp_path, monkeypatch):
    root = tmp_path / "world"
    root.mkdir()
    monkeypatch.chdir(root)
    rng, losses = random.Random(step.name), Losses(World(root, [step]), step)
    for kept in ("names", "some"):
        for example in losses.examples(kept, 1, rng):
            assert example.outcome == "same bytes", example


def test_losses_of_power_are_found_where_audio_is_not_synced(world):
    """A check of the method: a step that leaves out the sync of its audio would not pass."""
    losses = Losses(world, STEPS["compensate"])
    losses.ops = [op for op in losses.ops if not (op[0] == "sync" and ".wav" in op[1])]
    assert losses.after_the_end("names", random.Random(0)).outcome.startswith("other results")


def test_model_of_a_disk_drops_what_is_not_synced():
    ops = [("mkdir", "d"), ("create", "d/.a.tmp"), ("content", "d/.a.tmp", b"abcd"), ("rename", "d/.a.tmp", "d/a")]
    before, rng = {"old": b"1"}, random.Random(0)
    assert disk_after(before, ops, "nothing", rng) == before
    assert disk_after(before, ops, "names", rng) == before | {"d": None, "d/a": bytes(4)}
    synced = [*ops[:3], ("sync", "d/.a.tmp"), ops[3]]
    assert disk_after(before, synced, "names", rng)["d/a"] == b"abcd"
    assert disk_after(before, [*synced, ("sync", "d")], "nothing", rng) == before
    assert disk_after(before, [*synced, ("sync", "d"), ("sync", ".")], "nothing", rng)["d/a"] == b"abcd"
    found = [disk_after(before, ops, "some", rng) for _ in range(300)]
    assert {state.get("d/a") for state in found} == {None, b"", b"abcd", bytes(4), b"ab\0\0"}
    disk = Disk(before)
    for op in [*ops, ("rename", "old", "new"), ("remove", "nothing")]:
        disk.do(op)
    assert disk.files() == {"d": None, "d/a": b"abcd", "new": b"1"}
