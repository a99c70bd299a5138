"""Results are made again when audio changes that their inputs refer to but do not hold."""

import logging
import os
import shlex
import shutil

import numpy as np
import pytest
import soundfile
from datadirs import rir_dir, speech_dir
from rirmaker import coloured_rir

from roomeq.augment import augment
from roomeq.core import kept_hashes
from roomeq.core.audio import write_flac, write_wav
from roomeq.corpora import prepare_speech, read_measured
from roomeq.corpora.characterise import characterise
from roomeq.corpora.split import split_rirs


def change(path):
    """Attenuate a recording after its loudest sample; its length stays, so that no table of the corpus changes."""
    samples, fs_hz = soundfile.read(path)
    samples[abs(samples).argmax() + 1:] *= 0.7
    write_flac(path, samples) if path.suffix == ".flac" else write_wav(path, samples, fs_hz)


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


def test_linked_directories_give_the_same_speech(corpora, tmp_path):
    """A link to an RIR directory at another depth: `..` in its table leads out of the directory, not of the link."""
    before = run(tmp_path)
    linked = tmp_path / "a" / "b" / "real.train"
    linked.parent.mkdir(parents=True)
    linked.symlink_to(tmp_path / "real.train")
    split_rirs(tmp_path / "real", linked.parent / "again", sizes=(3, 2, 1), seed=0)
    augment(tmp_path / "clean" / "train.clean", linked, linked.parent / "rvb")
    after = {path.relative_to(linked.parent): path.read_bytes() for path in linked.parent.rglob("rvb/**/*.flac")}
    assert after == before
    below = tmp_path / "disk"
    (tmp_path / "c" / "d" / "e").mkdir(parents=True)
    below.symlink_to(tmp_path / "c" / "d" / "e")
    split_rirs(tmp_path / "real", below / "again", sizes=(3, 2, 1), seed=0)
    rir_list = (below / "again.train" / "rir_list").read_text()
    paths = [shlex.split(shlex.split(line)[4])[2] for line in rir_list.splitlines()]
    assert paths and all(os.path.exists(path) for path in paths)
    (tmp_path / "corpus" / "rir0.wav").unlink()
    with pytest.raises(ValueError, match="rir0.wav: missing since"):
        split_rirs(tmp_path / "real", linked.parent / "once_more", sizes=(3, 2, 1), seed=0)


def test_unchanged_recordings_remake_nothing(corpora, tmp_path, caplog):
    run(tmp_path)
    with caplog.at_level(logging.INFO):
        caplog.clear()
        run(tmp_path)
    assert sum("up to date" in record.getMessage() for record in caplog.records) == 9


def change_in_secret(path):
    """Change a recording and give it its modification time back; an RIR keeps its size too."""
    before = path.stat()
    change(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.suffix == ".flac" or path.stat().st_size == before.st_size


@pytest.mark.parametrize("pattern", ["corpus/rir*.wav", "speech/wav/*.flac"])
@pytest.mark.parametrize("n_steps", [1, 2, 3], ids=["augment", "split", "characterise"])
def test_later_steps_refuse_recordings_changed_in_place(pattern, n_steps, corpora, tmp_path):
    before = run(tmp_path)
    for path in tmp_path.glob(pattern):
        change_in_secret(path)
    with pytest.raises(ValueError, match=r"/(rir\d.wav|\w-1-\d+.flac): changed since \S+ was made of it: run all "
                                         r"steps that lead to \S+ again, from the first one"):
        if n_steps >= 3:
            characterise(tmp_path / "measured", tmp_path / "real")
        if n_steps >= 2:
            split_rirs(tmp_path / "real", tmp_path / "real", sizes=(3, 2, 1), seed=0)
        augment(tmp_path / "clean" / "train.clean", tmp_path / "real.train", tmp_path / "rvb")
    after = run(tmp_path)
    assert after.keys() == before.keys()
    assert after != before


@pytest.mark.parametrize("keep_all", [False, True], ids=["small", "kept"])
def test_equal_content_at_another_time_and_inode_remakes_nothing(keep_all, corpora, tmp_path, caplog, monkeypatch):
    if keep_all:
        monkeypatch.setattr(kept_hashes, "KEPT_FROM_BYTES", 0)
        monkeypatch.setattr(kept_hashes, "SETTLED_NS", 0)
    run(tmp_path)
    for path in [*tmp_path.glob("corpus/*.wav"), *tmp_path.glob("noises/*"), *tmp_path.glob("speech/wav/*")]:
        shutil.copy(path, tmp_path / "copy")
        os.replace(tmp_path / "copy", path)
    with caplog.at_level(logging.INFO):
        caplog.clear()
        run(tmp_path)
    assert sum("up to date" in record.getMessage() for record in caplog.records) == 9


@pytest.mark.parametrize("n_samples, lasts", [(3000, "0.188"), (12000, "0.750")])
def test_speech_that_is_not_as_long_as_its_table_says_is_refused(n_samples, lasts, tmp_path):
    clean, rirs = speech_dir(tmp_path / "clean"), rir_dir(tmp_path / "rirs")
    write_flac(clean / "wav" / "a-1-0002.flac", 0.1 * np.random.default_rng(0).standard_normal(n_samples))
    with pytest.raises(ValueError, match=rf"utterance a-1-0002: .*a-1-0002.flac lasts {lasts} s where utt2dur says "
                                         r"0.563 s: prepare the directory again"):
        augment(clean, rirs, tmp_path / "rvb")


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
