"""Exports are loaded with the toolkits themselves; skipped without them (tests/nightly/requirements.txt)."""

import os

import numpy as np
import pytest
import soundfile
from datadirs import FS, audio_of, rir_dir, speech_dir

from roomeq.augment import augment
from roomeq.corpora import prepare_speech
from roomeq.export import export
from roomeq.export.lhotse import LATE_RIRS
from roomeq.kaldi.datadir import read_data_dir

CLICK = 16000


@pytest.fixture
def rirs(tmp_path):
    return rir_dir(tmp_path / "rirs", simulated=True)


@pytest.fixture
def far_field(tmp_path, rirs):
    augment(speech_dir(tmp_path / "clean"), rirs, tmp_path / "rvb")
    return tmp_path / "rvb"


def moved(tmp_path, kind, source):
    """Export a directory, move the export, and go to another folder."""
    export(kind, source, tmp_path / "out" / source.name)
    (tmp_path / "there").mkdir(exist_ok=True)
    os.chdir("/")
    return (tmp_path / "out" / source.name).rename(tmp_path / "there" / source.name)


@pytest.fixture(autouse=True)
def keep_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_lhotse_cuts_are_the_utterances(tmp_path, far_field):
    lhotse = pytest.importorskip("lhotse")
    out = moved(tmp_path, "lhotse", far_field)
    recordings = lhotse.RecordingSet.from_file(out / "recordings.jsonl.gz").with_path_prefix(out)
    supervisions = lhotse.SupervisionSet.from_file(out / "supervisions.jsonl.gz")
    lhotse.validate_recordings_and_supervisions(recordings=recordings, supervisions=supervisions, read_data=True)
    data = read_data_dir(far_field)
    cuts = lhotse.CutSet.from_manifests(recordings, supervisions).trim_to_supervisions(keep_overlapping=False)
    assert {cut.supervisions[0].id for cut in cuts} == set(data.utterances)
    for cut in cuts:
        (supervision,) = cut.supervisions
        assert supervision.text == data.text[supervision.id]
        np.testing.assert_array_equal(cut.load_audio()[0], audio_of(data, supervision.id).astype(np.float32))


def test_lhotse_imports_clean_speech_of_ours(tmp_path):
    lhotse_kaldi = pytest.importorskip("lhotse.kaldi")
    lines = ["file,transcript,utt_id,speaker"]
    for n, path in enumerate(sorted((speech_dir(tmp_path / "corpus") / "wav").iterdir())):
        lines.append(f"wav/{path.name},WORDS {n},s{n}-1,s{n}")
    (tmp_path / "corpus/manifest.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "corpus/wav.scp").unlink()
    prepare_speech(tmp_path / "corpus", tmp_path / "data")
    recordings, supervisions, _ = lhotse_kaldi.load_kaldi_data_dir(tmp_path / "data/train.clean", FS)
    data = read_data_dir(tmp_path / "data/train.clean")
    assert {supervision.id: supervision.text for supervision in supervisions} == data.text
    for recording in recordings:
        assert recording.load_audio().shape[1] == recording.num_samples


def test_lhotse_reverberates_in_place(tmp_path, rirs):
    lhotse = pytest.importorskip("lhotse")
    out = moved(tmp_path, "lhotse", rirs)
    click = np.zeros(2 * CLICK)
    click[CLICK] = 0.5
    soundfile.write(tmp_path / "click.wav", click, FS)
    cuts = lhotse.CutSet.from_cuts([lhotse.Recording.from_file(tmp_path / "click.wav").to_cut()])
    rir_recordings = lhotse.RecordingSet.from_file(out / "rirs.jsonl.gz").with_path_prefix(out)
    assert len(rir_recordings) == 4 and not (out / f"{LATE_RIRS}.jsonl.gz").exists()
    for rir in rir_recordings:
        for early_only in (False, True):
            (cut,) = cuts.reverb_rir(lhotse.RecordingSet.from_recordings([rir]), early_only=early_only)
            assert np.argmax(np.abs(cut.load_audio()[0])) == CLICK, rir.id


def test_lhotse_mixes_our_noises(tmp_path, rirs, far_field):
    lhotse = pytest.importorskip("lhotse")
    out, speech = moved(tmp_path, "lhotse", rirs), moved(tmp_path, "lhotse", far_field)
    recordings = lhotse.RecordingSet.from_file(speech / "recordings.jsonl.gz").with_path_prefix(speech)
    supervisions = lhotse.SupervisionSet.from_file(speech / "supervisions.jsonl.gz")
    cuts = lhotse.CutSet.from_manifests(recordings, supervisions).trim_to_supervisions(
        keep_overlapping=False).to_eager()
    noises = lhotse.RecordingSet.from_file(out / "ambient_noises.jsonl.gz").with_path_prefix(out)
    for cut in cuts.mix(lhotse.CutSet.from_manifests(recordings=noises).to_eager(), snr=10, random_mix_offset=True):
        assert cut.load_audio().shape == (1, cut.num_samples)


def test_datasets_load_rirs_and_utterances(tmp_path, rirs, far_field, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", exc_type=ImportError)
    speech, out = moved(tmp_path, "huggingface", far_field), moved(tmp_path, "huggingface", rirs)
    cache, data = str(tmp_path / "cache"), read_data_dir(far_field)
    for row in datasets.load_dataset(str(speech), "speech", split="train", cache_dir=cache):
        assert row["text"] == data.text[row["id"]]
        np.testing.assert_array_equal(row["audio"]["array"], audio_of(data, row["id"]))
    for name, count in dict(rirs=4, noise_rirs=2, ambient_noises=2, point_noises=1).items():
        rows = datasets.load_dataset(str(out), name, split="train", cache_dir=cache)
        assert len(rows) == count
        assert all(row["audio"]["sampling_rate"] == FS for row in rows)
