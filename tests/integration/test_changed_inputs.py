"""Results are made again when audio changes that their inputs refer to but do not hold."""

import logging
import shutil

import numpy as np
import pytest
import soundfile
from datadirs import rir_dir, speech_dir
from rirmaker import coloured_rir

from roomeq.augment import augment
from roomeq.core.audio import write_flac, write_wav
from roomeq.corpora import prepare_speech, read_measured
from roomeq.corpora.characterise import characterise
from roomeq.corpora.split import split_rirs


def change(path):
    """Attenuate a recording after its loudest sample; its length stays, so that no table of the corpus changes."""
    samples, fs_hz = soundfile.read(path)
    samples[abs(samples).argmax() + 1:] *= 0.7
    (write_flac if path.suffix == ".flac" else write_wav)(path, samples, fs_hz)


@pytest.fixture
def corpora(tmp_path):
    """A folder of measured RIRs, one of noises, and a Kaldi data directory."""
    for n in range(6):
        write_wav(tmp_path / "corpus" / f"rir{n}.wav", coloured_rir(n))
        write_flac(tmp_path / "noises" / f"silence{n}.flac", 0.01 * np.random.default_rng(n).standard_normal(32000))
    return speech_dir(tmp_path / "speech", {f"{voice}-1-{n:04d}": 9000 for voice in "abcd" for n in range(3)})


def run(root):
    """Run all steps from corpora to far-field speech; return its audio."""
    read_measured(root / "corpus", root / "measured", noises=root / "noises")
    characterise(root / "measured", root / "real")
    split_rirs(root / "real", root / "real", sizes=(3, 2, 1), seed=0)
    if not (root / "clean").is_dir():
        (root / "clean").mkdir()
    prepare_speech(root / "speech", root / "clean")
    augment(root / "clean" / "train.clean", root / "real.train", root / "rvb")
    return {path.relative_to(root): path.read_bytes() for path in sorted((root / "rvb").rglob("*.flac"))}


@pytest.mark.parametrize("pattern", ["corpus/rir*.wav", "noises/*.flac", "speech/wav/*.flac"])
def test_changed_recordings_change_augmented_speech(pattern, corpora, tmp_path):
    before = run(tmp_path)
    assert before and run(tmp_path) == before
    for path in tmp_path.glob(pattern):
        change(path)
    after = run(tmp_path)
    assert after.keys() == before.keys()
    assert after != before


def test_unchanged_recordings_remake_nothing(corpora, tmp_path, caplog):
    run(tmp_path)
    with caplog.at_level(logging.INFO):
        caplog.clear()
        run(tmp_path)
    assert sum("up to date" in record.getMessage() for record in caplog.records) == 9


@pytest.mark.parametrize("pattern", ["clean/wav/*.flac", "elsewhere/*.wav"])
def test_audio_named_by_unstamped_directories_is_checked(pattern, tmp_path):
    clean, rirs = speech_dir(tmp_path / "clean"), rir_dir(tmp_path / "rirs")
    (tmp_path / "elsewhere").mkdir()
    for path in (rirs / "wav").glob("room*.wav"):
        shutil.move(path, tmp_path / "elsewhere")
    table = rirs / "rirs.jsonl"
    table.write_text(table.read_text().replace('"wav/', '"../elsewhere/'))
    made = []
    for _ in range(2):
        augment(clean, rirs, tmp_path / "rvb")
        made.append([path.read_bytes() for path in sorted((tmp_path / "rvb").rglob("*.flac"))])
        for path in tmp_path.glob(pattern):
            change(path)
    assert made[0] != made[1]
