"""Recordings that are no RIR are left out, with their names and a count, by every verb that uses recordings."""

import logging

import numpy as np
import pytest
from datadirs import speech_dir
from rir_damage import SHAPES, room_rir

from roomeq.cli import main
from roomeq.core.audio import write_wav
from roomeq.core.files import read_json, read_jsonl, write_jsonl
from roomeq.loop.usable import NO_RIR, usable_rirs
from roomeq.records.rir_dir import read_rirs

BAD = {"backwards": "time-reversed", "loud": "clipped by 26 dB", "late": "starts in mid-decay"}
KINDS = {"backwards": "time-reversed", "loud": "clipped", "late": "no onset"}


@pytest.fixture
def corpus(tmp_path):
    """Make six RIRs of three rooms, and three recordings that are none."""
    for n in range(6):
        write_wav(tmp_path / f"corpus/room{n % 3}/rir{n}.wav", room_rir(n, time_s=0.3 + 0.1 * (n % 3)))
    for name, shape in BAD.items():
        write_wav(tmp_path / f"corpus/room0/{name}.wav", SHAPES[shape](room_rir(7), np.random.default_rng(7)))
    return tmp_path / "corpus"


@pytest.fixture
def hand_written(corpus):
    """Return an RIR directory with a `rirs.jsonl` that holds nothing but names and geometry."""
    write_jsonl(corpus / "rirs.jsonl", [
        dict(id=path.stem, wav=str(path.relative_to(corpus)), room_id=path.parent.name, source_id="s", mic_id="m",
             room_dims_m=[5, 4, 3], source_pos_m=[1, 1, 1.5], mic_pos_m=[2 + n / 9, 2, 1.2])
        for n, path in enumerate(sorted(corpus.rglob("*.wav"), key=lambda path: path.stem))])
    return corpus


def run(*words):
    assert main([str(word) for word in words]) == 0


def ids(directory):
    return {row["id"] for row in read_rirs(directory)}


def test_read_measured_marks_names_and_counts_them_and_characterise_drops_them(corpus, tmp_path, caplog):
    caplog.set_level(logging.WARNING)
    run("read-measured", corpus, tmp_path / "measured")
    marks = {row["id"]: row["suspicious"] for row in read_rirs(tmp_path / "measured")}
    assert len(marks) == 9
    assert {key: reason.split(": ")[0] for key, reason in marks.items() if reason} == {
        f"room0-{name}": kind for name, kind in KINDS.items()}
    assert set(read_json(tmp_path / "measured/corpus.json")["suspicious"]) == {f"room0-{name}" for name in BAD}
    lines = [record.getMessage() for record in caplog.records]
    named = [line.split()[2] for line in lines if line.startswith("no RIR: ") and "room0/backwards.wav" in line]
    assert named == [str(corpus / "room0/backwards.wav")]
    assert any("3 of 9 recordings are no RIR" in line for line in lines)
    run("characterise", tmp_path / "measured", tmp_path / "out")
    assert f"no RIR: {corpus}/room0/backwards.wav: " in caplog.text
    assert len(ids(tmp_path / "out")) == 6
    assert read_json(tmp_path / "out/screening.json")["dropped_counts"] == {
        "no RIR (clipped)": 1, "no RIR (no onset)": 1, "no RIR (time-reversed)": 1}


def test_those_who_know_better_keep_them(corpus, hand_written, tmp_path):
    run("read-measured", "--kind", "folder", "--keep-suspicious", corpus, tmp_path / "measured")
    run("characterise", tmp_path / "measured", tmp_path / "out")
    assert len(ids(tmp_path / "out")) == 9
    run("characterise", "--keep-suspicious", hand_written, tmp_path / "kept")
    assert set(BAD) < ids(tmp_path / "kept")
    assert {row["suspicious"] for row in read_rirs(tmp_path / "kept")} == {None}


def test_hand_written_directory_is_checked_where_its_audio_is_used(hand_written, tmp_path, caplog):
    run("characterise", hand_written, tmp_path / "out")
    assert ids(tmp_path / "out") == {f"rir{n}" for n in range(6)}
    usable = usable_rirs([hand_written])
    assert len(usable.rirs) == 6 and [(entry.reason, entry.rirs) for entry in usable.left_out] == [(NO_RIR, 3)]
    run("simulate", "--num-rays", "200", "--noise-rirs", "0", hand_written, tmp_path / "sim")
    caplog.clear()
    run("fit-eq", "--num-components", "2", hand_written, tmp_path / "sim", tmp_path / "eq")
    assert {row["id"] for row in read_jsonl(tmp_path / "eq/measured.jsonl")} == {f"rir{n}" for n in range(6)}
    assert sum("3 of 9 recordings are no RIR" in record.getMessage() for record in caplog.records) == 1
    speech_dir(tmp_path / "speech")
    run("augment", "--point-snr", "none", "--snr", "none", tmp_path / "speech", hand_written, tmp_path / "far")
    assert not {row["rir"] for row in read_jsonl(next((tmp_path / "far").glob("*.jsonl")))} & set(BAD)


def test_null_in_a_hand_written_row_says_that_it_is_an_rir(hand_written, tmp_path):
    write_jsonl(hand_written / "rirs.jsonl", [row | dict(suspicious=None)
                                              for row in read_jsonl(hand_written / "rirs.jsonl")])
    run("characterise", hand_written, tmp_path / "out")
    assert set(BAD) < ids(tmp_path / "out")
