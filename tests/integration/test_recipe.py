"""The whole recipe at its smallest size gives the same bytes with other jobs and after interruptions."""

import random
import re
import shutil
import signal
import time

import pytest
from recipe_run import finish, hashes, kill, start

from roomeq.records.rir_dir import read_rirs, rir_path
from roomeq.validate import validate


@pytest.fixture(scope="module")
def corpora(tmp_path_factory):
    return tmp_path_factory.mktemp("recipe")


@pytest.fixture(scope="module")
def undisturbed(corpora, project_dir):
    """The output of a run with one job, and the hashes of its files."""
    where = corpora / "run-a"
    return finish(start(project_dir, where, corpora / "corpora", 1)), hashes(where)


def test_run_ends_with_data_directories_and_report(undisturbed, corpora):
    output, files = undisturbed
    assert "report: " in output.splitlines()[-1] and "data directory: " in output.splitlines()[-2]
    for name in ("train.real", "train.sim", "train.sim.EQ", "train.sim.loop", "dev.real", "dev.sim", "dev.sim.EQ",
                 "dev.sim.loop", "train.sim.free", "dev.sim.free", "test.real"):
        assert f"data/{name}.rvb/wav.scp" in files and f"data/{name}.rvb/segments" in files
    assert "exp/report/index.html" in files


def test_loop_finds_the_loudspeaker_responses(undisturbed, corpora):
    output, files = undisturbed
    added = re.findall(r"^added (\S+): held-out error ([\d.]+) -> ([\d.]+) JND, a fall of -?[\d.]+ to [\d.]+; of "
                       r"what it touches, by \d+ % \(\S+\)$", output, re.M)
    assert [name for name, *_ in added] == ["source_response"] and float(added[0][2]) < float(added[0][1])
    # dev has five RIRs
    assert "no room has usable RIRs of two places, one to calibrate it and one to score: the test set is not " in output
    where = corpora / "run-a"
    validate([where / "exp/loop", where / "data/rirs.sim.loop.train", where / "data/train.sim.loop.rvb"])
    for row in read_rirs(where / "data/rirs.sim.loop.train"):
        assert row["model"] == ([] if row["noise_for"] else ["source_response"])
    assert "Closed loop: effects added to the simulation" in (where / "exp/report/index.html").read_text()


def test_loop_is_skipped_without_room_geometry(undisturbed, corpora, project_dir):
    where = corpora / "run-e"
    measured = corpora / "run-a/data/rirs.real"
    (where / "measured").mkdir(parents=True)
    lines = ["file,id,room"] + [f"{rir_path(measured, row).resolve()},{row['id']},{row['room_id']}"
                                for row in read_rirs(measured)]
    (where / "measured/manifest.csv").write_text("\n".join(lines) + "\n")
    output = finish(start(project_dir, where, corpora / "corpora", 2, "--measured", str(where / "measured"),
                          "--noises", str(corpora / "corpora/speech/point_noises")))
    assert re.search(r"^no closed loop: .*rirs.real.train: (\d+) of \1 RIRs cannot be used \(\1: the room's dimensions "
                     r"and x and y of source and microphone are unknown\); .* and has 0: measure what is unknown",
                     output, re.MULTILINE)
    assert (where / "data/train.sim.EQ.rvb/wav.scp").is_file() and not (where / "data/rirs.sim.loop.train").exists()
    assert "Closed loop: effects added to the simulation" not in (where / "exp/report/index.html").read_text()


def test_two_jobs_and_a_second_run_give_the_same_bytes(undisturbed, corpora, project_dir):
    where = corpora / "run-b"
    finish(start(project_dir, where, corpora / "corpora", 2))
    assert hashes(where) == undisturbed[1]
    again = finish(start(project_dir, where, corpora / "corpora", 2))
    assert "up to date" in again
    assert hashes(where) == undisturbed[1]


def test_killed_and_restarted_run_gives_the_same_bytes(undisturbed, corpora, project_dir):
    where = corpora / "run-c"
    moments, killed = random.Random(0), []
    for _ in range(4):
        process = start(project_dir, where, corpora / "corpora", 2)
        time.sleep(moments.uniform(2, 15))
        kill(process)
        killed.append(process.returncode == -signal.SIGKILL)
    assert any(killed), "every run ended before it was killed"
    finish(start(project_dir, where, corpora / "corpora", 2))
    assert hashes(where) == undisturbed[1]


def test_stage_without_its_input_names_the_step_to_run(corpora, project_dir):
    process = start(project_dir, corpora / "run-d", corpora / "corpora", 1, "--stage", "4")
    output, _ = process.communicate(timeout=120)
    assert process.returncode != 0
    assert "rirs.sim.train/rirs.jsonl is missing: run steps/simulate_rirs.sh first" in output.splitlines()[-1]


def test_drawn_rooms_take_the_place_of_the_measured_ones(undisturbed, corpora, project_dir):
    where = corpora / "run-rooms"
    shutil.copytree(corpora / "run-a", where)
    finish(start(project_dir, where, corpora / "corpora", 2, "--rooms", "3", "--stage", "2", "--stop-stage", "4"))
    for kind in ("sim", "sim.EQ"):
        rooms = {x: {row["room_id"] for row in read_rirs(where / f"data/rirs.{kind}.{x}")} for x in ("train", "dev")}
        assert rooms == {"train": {"room00001", "room00002", "room00003"}, "dev": {"room00004"}}


def test_versions_of_test_utterances_leave_the_other_sets_alone(undisturbed, corpora, project_dir):
    where = corpora / "run-copies"
    shutil.copytree(corpora / "run-a", where)
    finish(start(project_dir, where, corpora / "corpora", 2, "--test-copies", "2", "--stage", "6", "--stop-stage", "6"))
    after, spoken = hashes(where), (where / "data/test.clean/text").read_text().splitlines()
    sets = {name.split("/")[1] for name in after | undisturbed[1]
            if ".rvb/" in name and after.get(name) != undisturbed[1].get(name)}
    assert sets == {"test.real.rvb"}
    ids = [line.split()[0] for line in (where / "data/test.real.rvb/text").read_text().splitlines()]
    assert ids == sorted(f"{line.split()[0]}-rvb{copy}" for line in spoken for copy in (1, 2))
