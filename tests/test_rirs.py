"""The RIR directory's own files."""

import argparse
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from roomeq.core.audio import write_wav
from roomeq.records.rir_dir import load_rir, read_rirs, validate_rirs, write_rirs

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
    """Parse a list as Kaldi's reverberate_data_dir.py does: words as of a shell, one of them the RIR."""
    parser = argparse.ArgumentParser()
    for option in ("--rir-id", "--room-id"):
        parser.add_argument(option, required=True)
    parser.add_argument("rir_rspecifier")
    return [parser.parse_args(shlex.split(line)) for line in (directory / "rir_list").read_text().splitlines()]


@pytest.mark.parametrize("folder", ["plain", "with blanks and 'quotes'"])
def test_stock_scripts_can_read_the_list(tmp_path, folder):
    write_two(tmp_path / folder)
    listed = stock_rir_list(tmp_path / folder)
    assert [one.rir_id for one in listed] == ["a", "b"]
    for one in listed:
        words = shlex.split(one.rir_rspecifier)
        assert words[0] == "sox" and words[-1] == "|" and Path(words[2]).is_file()


@pytest.mark.skipif(not shutil.which("sox"), reason="needs sox, as stock Kaldi does")
def test_the_pipe_gives_16_bit_audio_at_full_scale(tmp_path):
    write_two(tmp_path)
    command = stock_rir_list(tmp_path)[0].rir_rspecifier.rstrip(" |")
    wav = subprocess.run(shlex.split(command), capture_output=True, check=True, env=dict(os.environ)).stdout
    samples = np.frombuffer(wav[-2 * len(RIR):], dtype="<i2") / 2 ** 15
    assert np.max(np.abs(samples)) == pytest.approx(10 ** (-1 / 20), abs=1e-3)
    np.testing.assert_allclose(samples / samples[20] * RIR[20], RIR, atol=2e-6)


def test_what_is_written_is_read(tmp_path):
    rows = write_two(tmp_path)
    assert validate_rirs(tmp_path) == 2
    assert [row["id"] for row in read_rirs(tmp_path)] == ["a", "b"]
    np.testing.assert_allclose(load_rir(tmp_path, rows[0]), RIR, atol=1e-9)
