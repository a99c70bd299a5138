"""Files of an RIR directory: `rirs.jsonl` and `rir_list`."""

import argparse
import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.core.audio import write_wav
from roomeq.core.files import write_json, write_jsonl
from roomeq.core.stamps import FORMAT
from roomeq.records.rir_dir import (
    load_rir,
    read_rirs,
    relocated,
    validate_noises,
    validate_rirs,
    warn_of_unused_keys,
    write_noises,
    write_rirs,
)

RIR = np.r_[np.zeros(20), 0.03, -0.02, 0.001 * np.ones(600)]


def write_two(directory):
    rows = []
    for name in ("a", "b"):
        write_wav(directory / "wav" / f"{name}.wav", RIR)
        rows.append(dict(id=name, wav=f"wav/{name}.wav", room_id="it-s", source_id="s", mic_id="m", fs_hz=16000,
                         n_samples=len(RIR)))
    write_rirs(directory, rows)
    return rows


def stock_rir_list(directory):
    """Parse `rir_list` as Kaldi's reverberate_data_dir.py does: shell words, one of them the RIR."""
    parser = argparse.ArgumentParser()
    for option in ("--rir-id", "--room-id"):
        parser.add_argument(option, required=True)
    parser.add_argument("rir_rspecifier")
    return [parser.parse_args(shlex.split(line)) for line in (directory / "rir_list").read_text().splitlines()]


def test_rir_of_a_directory_at_another_rate_is_read_at_its_own(tmp_path):
    write_wav(tmp_path / "a.wav", RIR, 48000)
    write_rirs(tmp_path, [row("a", wav="a.wav", fs_hz=48000, n_samples=len(RIR))])
    (high,) = read_rirs(tmp_path)
    with pytest.raises(ValueError, match="RIR a has fs_hz=48000 where 16000 is expected: .* give load_rir their rate"):
        load_rir(tmp_path, high)
    np.testing.assert_allclose(load_rir(tmp_path, high, high["fs_hz"]), RIR, atol=1e-9)


@pytest.mark.parametrize("folder", ["plain", "with blanks and 'quotes'"])
def test_stock_scripts_parse_rir_list(tmp_path, folder):
    write_two(tmp_path / folder)
    entries = stock_rir_list(tmp_path / folder)
    assert [entry.rir_id for entry in entries] == ["a", "b"]
    for entry in entries:
        words = shlex.split(entry.rir_rspecifier)
        assert words[0] == "sox" and words[-1] == "|" and Path(words[2]).is_file()


@pytest.mark.skipif(not shutil.which("sox"), reason="needs sox, as stock Kaldi does")
def test_rir_list_pipe_yields_16_bit_full_scale_audio(tmp_path):
    write_two(tmp_path)
    command = stock_rir_list(tmp_path)[0].rir_rspecifier.rstrip(" |")
    wav = subprocess.run(shlex.split(command), capture_output=True, check=True, env=dict(os.environ)).stdout
    samples = np.frombuffer(wav[-2 * len(RIR):], dtype="<i2") / 2 ** 15
    assert np.max(np.abs(samples)) == pytest.approx(10 ** (-1 / 20), abs=1e-3)
    np.testing.assert_allclose(samples / samples[20] * RIR[20], RIR, atol=2e-6)


def test_written_rows_and_audio_are_read_back(tmp_path):
    rows = write_two(tmp_path)
    assert validate_rirs(tmp_path) == 2
    assert [row["id"] for row in read_rirs(tmp_path)] == ["a", "b"]
    np.testing.assert_allclose(load_rir(tmp_path, rows[0]), RIR, atol=1e-9)


def without_keys(directory, *keys):
    """Rewrite `rirs.jsonl` as a person may write it: without some keys."""
    lines = (directory / "rirs.jsonl").read_text().splitlines()
    rows = [{key: value for key, value in json.loads(line).items() if key not in keys} for line in lines]
    (directory / "rirs.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_rate_and_length_are_read_from_the_audio(tmp_path):
    write_two(tmp_path)
    complete = read_rirs(tmp_path)
    without_keys(tmp_path, "fs_hz", "n_samples")
    assert read_rirs(tmp_path) == complete
    assert validate_rirs(tmp_path) == 2


def test_missing_audio_of_a_short_row_names_line_and_file(tmp_path):
    write_two(tmp_path)
    without_keys(tmp_path, "n_samples")
    (tmp_path / "wav" / "b.wav").unlink()
    with pytest.raises(ValueError, match=r"rirs\.jsonl:2: .*wav/b\.wav: no such audio file: check the path; roomeq "
                                         "simulate needs no audio if the row states both"):
        read_rirs(tmp_path)


def test_noise_of_several_channels_is_refused_as_by_augment(tmp_path):
    write_wav(tmp_path / "n.wav", np.ones((1000, 2)))
    write_noises(tmp_path, [dict(id="n", wav="n.wav", kind="ambient")])
    with pytest.raises(ValueError, match=r"n\.wav: 2 channels where one is expected: choose one, or split the file"):
        validate_noises(tmp_path)


@pytest.mark.parametrize("known, message", [
    (dict(temperature_c=400.0), r"rirs.jsonl: RIR a: temperature_c=400 must lie in"),
    (dict(fs_hz=4000), r"rirs.jsonl: RIR a: fs=4000 must be a whole number of hertz from 8000")])
def test_values_out_of_range_are_refused(tmp_path, known, message):
    write_rir_dir(tmp_path, [(row("a"), coloured_rir(0))])
    write_rirs(tmp_path, [read_rirs(tmp_path)[0] | known])
    with pytest.raises(ValueError, match=message):
        validate_rirs(tmp_path)


@pytest.mark.parametrize("angles", ["90.0, 0.0, 0.0", "0.5, 0.1, 0.0"])
def test_facings_in_degrees_or_radians_are_refused(tmp_path, angles):
    write_rir_dir(tmp_path, [(row("a"), coloured_rir(0))])
    write_jsonl(tmp_path / "rirs.jsonl", [read_rirs(tmp_path)[0] | dict(source_dir=[*map(float, angles.split(","))])])
    with pytest.raises(ValueError, match=rf"source_dir=\[{angles}\] must be a unit vector: three .* no angles"):
        read_rirs(tmp_path)


def test_noises_at_8_khz_are_valid(tmp_path):
    write_wav(tmp_path / "n.wav", coloured_rir(0), 8000)
    write_noises(tmp_path, [dict(id="n", wav="n.wav", room_id=None, kind="ambient", fs_hz=8000)])
    assert validate_noises(tmp_path) == 1


def test_numpy_numbers_are_written_as_plain_ones(tmp_path):
    rows = write_two(tmp_path)
    write_rirs(tmp_path, [row | dict(distance_m=np.float64(2.5)) for row in rows])
    assert [row["distance_m"] for row in read_rirs(tmp_path)] == [2.5, 2.5]


def test_relocated_rows_name_the_same_audio_and_mesh(tmp_path):
    rows = [dict(id="a", wav="wav/a.wav", mesh="../rooms/a.obj"), dict(id="b", wav="../b.wav", mesh=None)]
    there = relocated(rows, tmp_path / "x" / "in", tmp_path / "out")
    assert [row["wav"] for row in there] == ["../x/in/wav/a.wav", "../x/b.wav"]
    assert [row["mesh"] for row in there] == ["../x/rooms/a.obj", None]


def test_unused_keys_of_a_hand_written_table_are_logged(tmp_path, caplog):
    rows = [row("r1", target_t60=0.3, material={}, mic_pos=[1, 2, 1], note="x", wav="r1.wav"),
            row("r2", target_t60_s=0.3, wav="r2.wav")]
    warn_of_unused_keys(tmp_path, rows)
    assert caplog.messages == [f"{tmp_path}/rirs.jsonl: keys not used: material (did you mean materials?), mic_pos "
                               "(did you mean mic_pos_m?), note, target_t60 (did you mean target_t60_s?)"]
    caplog.clear()
    warn_of_unused_keys(tmp_path, rows[1:])
    write_json(tmp_path / ".done", dict(step="characterise", key="", files={}, format=FORMAT))
    warn_of_unused_keys(tmp_path, rows)
    assert not caplog.messages
