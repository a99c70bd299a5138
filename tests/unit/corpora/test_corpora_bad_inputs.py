"""Measured corpora that cannot be used: one line that names file, value, rule and remedy; earlier results stay."""

import json

import numpy as np
import pytest
from corpora_examples import make_folder, make_table, put, put_sofa, put_text, rir

from roomeq.corpora import read_measured, read_noises
from roomeq.records.rir_dir import read_rirs


def put_empty(path):
    put_text(path, "")


def put_cut_wav(path):
    put(path)
    path.write_bytes(path.read_bytes()[:-300])


def put_cut_flac(path):
    put(path.with_suffix(".flac"), rir("x", 16000))
    data = path.with_suffix(".flac").read_bytes()
    path.with_suffix(".flac").write_bytes(data[:len(data) // 2])


def put_nan(path):
    put(path, np.where(np.arange(800) == 9, np.nan, rir()), subtype="FLOAT")


BAD = {
    "empty": (put_empty, r"bad\.wav: audio file is empty \(0 bytes\)"),
    "text": (lambda path: put_text(path, "no audio"), r"bad\.wav: cannot be read as audio"),
    "cut wav": (put_cut_wav, r"bad\.wav: truncated: \d+ bytes of \d+: copy it again"),
    "cut flac": (put_cut_flac, r"bad\.flac: broken audio"),
    "no samples": (lambda path: put(path, np.zeros(0)), r"bad\.wav: holds 0 samples"),
    "nan": (put_nan, r"bad\.wav: holds NaN or infinite samples"),
    "silent": (lambda path: put(path, np.zeros(800)), r"bad\.wav: RIR is silent \(all samples 0\)"),
    "8 kHz": (lambda path: put(path, fs_hz=8000), r"bad\.wav: sample rate 8000 Hz must be at least 16000 Hz"),
}


@pytest.fixture(params=BAD)
def bad(request, tmp_path):
    make, message = BAD[request.param]
    make_folder(tmp_path / "corpus")
    make(tmp_path / "corpus" / "kitchen" / "bad.wav")
    return tmp_path / "corpus", message


def test_bad_audio_is_an_error_or_skipped(bad, tmp_path):
    source, message = bad
    with pytest.raises(ValueError, match=message) as caught:
        read_measured(source, tmp_path / "out")
    assert "\n" not in str(caught.value) and "--skip-bad" in str(caught.value)
    assert not (tmp_path / "out").exists()
    out = read_measured(source, tmp_path / "out", skip_bad=True)
    assert len(read_rirs(out)) == 4
    assert len(json.loads((out / "corpus.json").read_text())["skipped"]) == 1


def test_other_channels_and_measurements_of_a_file_are_kept(tmp_path):
    irs = np.stack([rir(name, 800) for name in "abcd"])
    irs[1] = 0
    put(tmp_path / "wav" / "array.wav", irs.T)
    put_sofa(tmp_path / "sofa" / "lab.sofa", 4, Data_IR=irs[:, None])
    for source, ids, bad in ((tmp_path / "wav", ["array_ch0", "array_ch2", "array_ch3"], r"array\.wav \(channel 1\)"),
                             (tmp_path / "sofa", ["lab_m0", "lab_m2", "lab_m3"], r"lab\.sofa \(lab_m1\)")):
        with pytest.raises(ValueError, match=f"{bad}: RIR is silent"):
            read_measured(source, tmp_path / "out")
        out = read_measured(source, tmp_path / "out", skip_bad=True)
        assert [row["id"] for row in read_rirs(out)] == ids


def test_bad_audio_keeps_the_earlier_result(tmp_path):
    source = make_folder(tmp_path / "corpus")
    before = (read_measured(source, tmp_path / "out") / "rirs.jsonl").read_bytes()
    put_empty(source / "hall" / "bad.wav")
    with pytest.raises(ValueError, match="bad.wav"):
        read_measured(source, tmp_path / "out")
    assert (tmp_path / "out" / "rirs.jsonl").read_bytes() == before


@pytest.mark.parametrize("make, message", [
    (put_empty, "is empty"), (put_cut_wav, "truncated"), (put_cut_flac, "broken audio"),
    (lambda path: put(path, fs_hz=8000), "sample rate 8000 Hz"), (put_nan, "holds NaN or infinite samples"),
    (lambda path: put(path, np.zeros(800)), r"noise is silent \(all samples the same\)"),
    (lambda path: put(path, np.full(800, 0.25)), r"noise is silent \(all samples the same\)"),
    (lambda path: put(path, np.zeros(800), fs_hz=44100), r"noise is silent \(all samples the same\)")])
def test_bad_noise_is_an_error_or_skipped(tmp_path, make, message):
    put(tmp_path / "noise" / "good.wav")
    make(tmp_path / "noise" / "bad.wav")
    with pytest.raises(ValueError, match=rf"bad\.(wav|flac): .*{message}"):
        read_noises(tmp_path / "noise", tmp_path / "out")
    read_noises(tmp_path / "noise", tmp_path / "out", skip_bad=True)
    assert (tmp_path / "out" / "noises.jsonl").read_text().count("\n") == 1


@pytest.mark.parametrize("read, table", [(read_measured, "rirs.jsonl"), (read_noises, "noises.jsonl")])
def test_another_bound_on_the_length_changes_what_is_left_out(tmp_path, monkeypatch, read, table):
    source, out = make_folder(tmp_path / "corpus"), tmp_path / "out"
    put(source / "hall" / "long.wav", rir("long", 3200))
    n_rows = []
    for hours in (0.15 / 3600, 1, 0.15 / 3600):
        monkeypatch.setenv("ROOMEQ_MAX_AUDIO_HOURS", str(hours))
        read(source, out, skip_bad=True)
        n_rows.append(len((out / table).read_text().splitlines()))
    assert n_rows[0] == n_rows[1] - 1 == n_rows[2] > 0
    monkeypatch.setenv("ROOMEQ_MAX_AUDIO_HOURS", "1")
    made = (read(source, out) / ".done").stat().st_mtime_ns
    monkeypatch.setenv("ROOMEQ_MAX_AUDIO_HOURS", "2")
    assert (read(source, out) / ".done").stat().st_mtime_ns == made  # nothing is left out


def test_duplicate_ids_name_both_files(tmp_path):
    source = make_folder(tmp_path / "corpus")
    put(source / "kitchen" / "near.flac")
    with pytest.raises(ValueError, match=r"near\.wav: id 'kitchen-near' is also that of .*near\.flac: ids must be"):
        read_measured(source, tmp_path / "out")


def test_listed_file_that_is_missing_is_an_error(tmp_path):
    source = make_table(tmp_path / "corpus")
    (source / "rirs" / "lab" / "one.flac").unlink()
    with pytest.raises(ValueError, match=r"one\.flac: no such audio file"):
        read_measured(source, tmp_path / "out")


def test_source_without_usable_rirs_is_an_error(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty: no audio files below it: check the path"):
        read_measured(tmp_path / "empty", tmp_path / "out")
    with pytest.raises(ValueError, match="absent: no such file or directory"):
        read_measured(tmp_path / "absent", tmp_path / "out")
    with pytest.raises(ValueError, match="kind='x' must be one of reverbdb, slr28"):
        read_measured(tmp_path / "empty", tmp_path / "out", kind="x")
    with pytest.raises(ValueError, match="empty: no manifest.csv in it: name the CSV file itself"):
        read_measured(tmp_path / "empty", tmp_path / "out", kind="table")
    put_empty(tmp_path / "bad" / "a.wav")
    with pytest.raises(ValueError, match=r"none of 1 RIR files can be used, the first because: .*a\.wav"):
        read_measured(tmp_path / "bad", tmp_path / "out", skip_bad=True)


def test_output_with_other_files_is_not_replaced(tmp_path):
    put_text(tmp_path / "out" / "thesis.txt", "mine")
    with pytest.raises(ValueError, match="exists and was not made by roomeq"):
        read_measured(make_folder(tmp_path / "corpus"), tmp_path / "out")
    assert (tmp_path / "out" / "thesis.txt").read_text() == "mine"
