"""Augmented data directories: content, independence of jobs and order, refused input."""

import gzip
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import kaldiio
import numpy as np
import pytest
import soundfile
from datadirs import FS, LENGTHS, audio_of, burst, decay, rir_dir, rir_row, speech_dir
from joblib.externals.loky import get_reusable_executor

from roomeq.augment import augment, far_field
from roomeq.augment.distribution import parse_distribution
from roomeq.augment.mix import without_rumble
from roomeq.core.audio import write_flac, write_wav
from roomeq.export import export
from roomeq.kaldi import validate_data_dir
from roomeq.kaldi.datadir import read_data_dir
from roomeq.kaldi.wavscp import read_entry
from roomeq.records.rir_dir import load_rir, read_rirs, write_noises, write_rirs

SAMPLE = 2.0**-15


def rows_of(directory):
    return {row["id"]: row for row in map(json.loads, (directory / "augment.jsonl").read_text().splitlines())}


def bytes_of(directory):
    return {str(path.relative_to(directory)): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def table(path):
    return dict(line.split(maxsplit=1) for line in path.read_text().splitlines())


@pytest.fixture
def inputs(tmp_path):
    return speech_dir(tmp_path / "clean"), rir_dir(tmp_path / "rirs")


def test_utterances_match_equation_1_in_float64(tmp_path, inputs):
    """Compute the utterances again in float64 from the draws in `augment.jsonl`."""
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "out", point_noise_prob=1.0, seed=3)
    source, result = read_data_dir(clean), read_data_dir(tmp_path / "out")
    responses = {row["id"]: load_rir(rirs, row) for row in read_rirs(rirs)}
    noises = {key: without_rumble(soundfile.read(rirs / f"wav/{key}.flac")[0], FS)
              for key in ("hum-room0", "hum-room1", "tap")}
    for key, row in rows_of(tmp_path / "out").items():
        x, n = without_rumble(audio_of(source, key), FS), LENGTHS[key]
        speech = np.convolve(x, responses[row["rir"]])[row["shift"]:row["shift"] + n]
        expected = speech.copy()
        for noise in row["noises"]:
            h = responses[noise["rir"]] if noise["rir"] else np.ones(1)
            want = n + len(h) - 1
            raw, fade = noises[noise["id"]], min(800, len(noises[noise["id"]]) // 4)
            if len(raw) < want:
                angle = np.pi / 2 * (np.arange(fade) + 0.5) / fade
                ring = raw[:-fade].copy()
                ring[:fade] = raw[:fade] * np.sin(angle) + raw[-fade:] * np.cos(angle)
                heard = ring[(noise["start"] + np.arange(want)) % len(ring)]
            else:
                heard = raw[noise["start"]:noise["start"] + want]
            heard = np.convolve(heard, h, mode="valid")
            expected += heard * np.sqrt(np.mean(speech**2) / np.mean(heard**2) / 10 ** (noise["snr_db"] / 10))
        expected *= np.sqrt(np.mean(x**2) / np.mean(expected**2)) * 10 ** (row["peak_gain_db"] / 20)
        got = audio_of(result, key)
        assert len(got) == n
        assert np.max(np.abs(got - expected)) < 2 * SAMPLE
        kinds = [noise["kind"] for noise in row["noises"]]
        assert kinds == ["ambient", "point"]
        assert row["noises"][0]["id"] == f"hum-{row['room']}"
        assert row["noises"][1]["rir"] != row["rir"] and row["noises"][1]["rir"].startswith(row["room"])


def test_offset_of_the_speech_is_not_reverberated(tmp_path, inputs):
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "without")
    for key in LENGTHS:
        samples, _ = soundfile.read(clean / f"wav/{key}.flac")
        write_flac(clean / f"wav/{key}.flac", samples + 0.1)
    augment(clean, rirs, tmp_path / "with")
    without, with_offset = (read_data_dir(tmp_path / name) for name in ("without", "with"))
    for key in LENGTHS:
        np.testing.assert_allclose(audio_of(with_offset, key), audio_of(without, key), atol=5 * SAMPLE)


def test_languages_are_those_of_clean_speech(tmp_path, inputs):
    clean, rirs = inputs
    (clean / "utt2lang").write_text("".join(f"{key} {'de' if key < 'b' else 'en'}\n" for key in LENGTHS))
    augment(clean, rirs, tmp_path / "out")
    assert (tmp_path / "out/utt2lang").read_text() == (clean / "utt2lang").read_text()
    validate_data_dir(tmp_path / "out")
    export("lhotse", tmp_path / "out", tmp_path / "lhotse")
    with gzip.open(tmp_path / "lhotse/supervisions.jsonl.gz", "rt") as lines:
        assert {row["id"]: row["language"] for row in map(json.loads, lines)} == table(clean / "utt2lang")


def test_tables_and_summary_match_the_rows(tmp_path, inputs):
    clean, rirs = inputs
    out = tmp_path / "out"
    summary = augment(clean, rirs, out, snr_db="list 10,20", point_noise_prob=0)
    assert validate_data_dir(out) == 5
    assert sorted(path.name for path in out.iterdir()) == sorted(
        "wav.scp segments text utt2spk spk2utt spk2gender reco2dur utt2dur utt2rir utt2snr utt2uniq "
        "augment.jsonl summary.json audio .done".split())
    recordings = list(table(out / "wav.scp"))
    (mark,) = {name[len("a-1"):] for name in recordings}
    assert recordings == [f"a-1{mark}", f"a-2{mark}", f"b-1{mark}"] and re.fullmatch("-[0-9a-f]{8}", mark)
    assert table(out / "wav.scp")[f"a-1{mark}"] == f"flac -c -d -s {out}/audio/a/a-1.flac |"
    assert table(out / "segments") == {
        "a-1-0001": f"a-1{mark} 0.00 0.7715625", "a-1-0002": f"a-1{mark} 0.78 1.3425625",
        "a-2-0001": f"a-2{mark} 0.00 1.00",
        "b-1-0001": f"b-1{mark} 0.00 1.2506875", "b-1-0002": f"b-1{mark} 1.26 1.76"}
    assert table(out / "reco2dur") == {f"a-1{mark}": "1.3425625", f"a-2{mark}": "1.00", f"b-1{mark}": "1.76"}
    for name in ("text", "utt2spk", "spk2utt", "spk2gender", "utt2dur"):
        assert (out / name).read_text() == (clean / name).read_text()
    assert set(table(out / "utt2snr").values()) <= {"10.00", "20.00"}
    assert table(out / "utt2rir") == {key: row["rir"] for key, row in rows_of(out).items()}
    assert table(out / "utt2uniq") == {key: key for key in LENGTHS}
    assert summary["utterances"] == 5 and summary["recordings"] == 3 and summary["rirs"] == 6
    assert summary["hours"] == pytest.approx(sum(LENGTHS.values()) / FS / 3600)
    assert sum(summary["snr_histogram"].values()) == 5


@pytest.mark.parametrize("packing", ["recording", "utterance"])
def test_bytes_do_not_depend_on_jobs_parts_or_repetition(tmp_path, inputs, monkeypatch, packing):
    made = {}

    def run(place, *calls):
        """Augment in a folder of its own to the same relative path, which `wav.scp` names."""
        (tmp_path / place).mkdir()
        monkeypatch.chdir(tmp_path / place)
        get_reusable_executor().shutdown()  # joblib's workers stay in the folder they were started in
        for call in calls:
            summary = augment("../clean", "../rirs", "out", **dict(packing=packing, copies=2, seed=5) | call)
            assert (summary is None) == ("part" in call)
        made[place] = bytes_of(Path("out"))

    run("one", dict(nj=1))
    run("two", dict(nj=2))
    run("parts", dict(part="3/3"), dict(part="1/3"), dict(part="2/3"), {})
    run("seed", dict(seed=6))
    assert made["one"] == made["two"] == made["parts"] != made["seed"]
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "seed").rglob("*")}
    augment("../clean", "../rirs", "out", packing=packing, copies=2, seed=6)
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "seed").rglob("*")}


def test_utterance_does_not_depend_on_other_utterances(tmp_path, inputs):
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "all")
    some = speech_dir(tmp_path / "some")
    keep = {"a-1-0002", "b-1-0002"}
    for name in ("wav.scp", "text", "utt2spk", "utt2dur", "reco2dur"):
        lines = (some / name).read_text().splitlines()
        (some / name).write_text("".join(f"{line}\n" for line in lines if line.split()[0] in keep))
    (some / "spk2utt").write_text("a a-1-0002\nb b-1-0002\n")
    augment(some, rirs, tmp_path / "few")
    for key in keep:
        assert np.array_equal(audio_of(read_data_dir(tmp_path / "all"), key),
                              audio_of(read_data_dir(tmp_path / "few"), key))


def test_copies_get_new_ids_and_draws(tmp_path, inputs):
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "out", copies=3)
    assert validate_data_dir(tmp_path / "out") == 15
    rows = rows_of(tmp_path / "out")
    assert list(rows) == [f"{key}-rvb{n}" for key in sorted(LENGTHS) for n in (1, 2, 3)]
    assert table(tmp_path / "out/utt2uniq") == {key: key.removesuffix(key[-5:]) for key in rows}
    assert len({(row["rir"], row["snr_db"]) for row in rows.values()}) > 10
    assert table(tmp_path / "out/text")["a-2-0001-rvb2"] == "WORDS OF A-2-0001"


def test_recordings_of_two_sets_have_different_ids(tmp_path, inputs):
    """Kaldi's `combine_data.sh` takes recordings with the same id for the same audio."""
    for seed in (0, 1):
        augment(*inputs, tmp_path / f"out{seed}", seed=seed)
    one, other = (set(table(tmp_path / f"out{seed}/wav.scp")) for seed in (0, 1))
    assert len(one) == len(other) and not one & other


def test_utterance_is_read_once_for_all_its_copies(tmp_path, inputs, monkeypatch):
    read = []
    monkeypatch.setattr(far_field, "read_entry", lambda entry, *given, **named: read.append(entry) or
                        read_entry(entry, *given, **named))
    augment(*inputs, tmp_path / "out", copies=4)
    assert len(read) == len(LENGTHS)


def test_directories_with_the_same_ids_give_the_same_draws(tmp_path, inputs):
    """Same ids, same ranks: rows of the paper's table differ in the RIRs' sound and in nothing else."""
    clean, _ = inputs
    sim, eq = rir_dir(tmp_path / "sim", simulated=True, seed=1), rir_dir(tmp_path / "eq", simulated=True, seed=2)
    for name, rirs in (("a", sim), ("b", eq)):
        augment(clean, rirs, tmp_path / name, point_noise_prob=1.0)
    a, b = rows_of(tmp_path / "a"), rows_of(tmp_path / "b")
    drawn = ("rir", "shift", "room")
    for key in a:
        assert [a[key][name] for name in drawn] == [b[key][name] for name in drawn]
        assert a[key]["noises"] == b[key]["noises"]
        assert not a[key]["rir"].endswith("-2")
    made_for = [row["noises"][1]["rir"] for row in a.values() if row["rir"] == "room0-0"]
    assert set(made_for) <= {"room0-2"}
    real = rir_dir(tmp_path / "real", n_rooms=4, seed=3)
    augment(clean, real, tmp_path / "c", point_noise_prob=1.0)
    for key, row in rows_of(tmp_path / "c").items():
        assert [noise["snr_db"] for noise in row["noises"]] == [noise["snr_db"] for noise in a[key]["noises"]]


def test_draw_rooms_equally_draws_the_room_first(tmp_path):
    lengths = {f"s-{n:04d}": 400 for n in range(300)}
    clean, rirs = speech_dir(tmp_path / "clean", lengths), tmp_path / "rirs"
    h = decay(np.random.default_rng(0), 400)
    rows = [rir_row(f"r{n}", "big" if n < 9 else "small", h) for n in range(10)]
    for row in rows:
        write_wav(rirs / row["wav"], h)
    write_rirs(rirs, rows)
    for weight, share in ((False, 0.1), (True, 0.5)):
        augment(clean, rirs, tmp_path / f"out{weight}", draw_rooms_equally=weight)
        rooms = [row["room"] for row in rows_of(tmp_path / f"out{weight}").values()]
        assert rooms.count("small") / 300 == pytest.approx(share, abs=0.08)


def test_snr_none_adds_no_noise(tmp_path, inputs):
    clean, rirs = inputs
    summary = augment(clean, rirs, tmp_path / "out", snr_db="none", point_snr_db="none")
    assert summary["snr_histogram"] == dict(none=5) and not summary["noises"]
    assert set(table(tmp_path / "out/utt2snr").values()) == {"inf"}


def test_room_with_one_rir_has_no_point_noise(tmp_path, inputs):
    clean, rirs = inputs[0], tmp_path / "single"
    rir_dir(rirs, n_rooms=1)
    write_rirs(rirs, read_rirs(rirs)[:1])
    augment(clean, rirs, tmp_path / "out", point_noise_prob=1.0)
    assert all(len(row["noises"]) == 1 for row in rows_of(tmp_path / "out").values())


def test_flac_archive_and_segments_input_give_the_same_audio(tmp_path, inputs):
    """The same speech as FLAC files, as a Kaldi archive, and as segments of one long recording."""
    clean, rirs = inputs
    data = read_data_dir(clean)
    audio = {key: audio_of(data, key) for key in data.utterances}
    speakers = "".join(f"{key} {key[0]}\n" for key in audio)
    for name in ("ark", "long"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "utt2spk").write_text(speakers)
    kaldiio.save_ark(str(tmp_path / "wav.ark"), {key: (FS, (x * 32768).astype(np.int16)) for key, x in audio.items()},
                     scp=str(tmp_path / "ark/wav.scp"))
    start, lines = 0, []
    for key, x in audio.items():
        lines.append(f"{key} long {start / FS:.7f} {(start + len(x)) / FS:.7f}\n")
        start += len(x)
    write_flac(tmp_path / "long.flac", np.concatenate(list(audio.values())).astype(np.float32))
    (tmp_path / "long/segments").write_text("".join(lines))
    (tmp_path / "long/wav.scp").write_text(f"long flac -c -d -s {tmp_path}/long.flac |\n")
    results = {}
    for source in (clean, tmp_path / "ark", tmp_path / "long"):
        augment(source, rirs, tmp_path / f"out.{source.name}", packing="utterance")
        result = read_data_dir(tmp_path / f"out.{source.name}")
        results[source.name] = {key: audio_of(result, key) for key in audio}
    for key, x in results["clean"].items():
        assert np.array_equal(x, results["ark"][key])
        assert np.max(np.abs(x - results["long"][key])) <= 2 * SAMPLE  # written to 16 bits once more


def test_long_chapters_are_split_into_recordings(tmp_path, inputs, monkeypatch):
    monkeypatch.setattr("roomeq.augment.pack.MAX_RECORDING_S", 1.5)
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "out", copies=2)
    assert validate_data_dir(tmp_path / "out") == 10
    durations = {key: float(value) for key, value in table(tmp_path / "out/reco2dur").items()}
    assert max(durations.values()) <= 1.5 + 0.02
    assert {"a-1", "a-1-2"} <= {name[:-len("-01234567")] for name in durations}


def test_noises_of_another_directory_are_used(tmp_path, inputs):
    clean, rirs = inputs
    more = tmp_path / "noises"
    write_flac(more / "fan.flac", burst(np.random.default_rng(0), 9000))
    write_noises(more, [dict(id="fan", wav="fan.flac", room_id=None, kind="point", duration_s=1.0, fs_hz=FS)])
    (rirs / "noises.jsonl").unlink()
    augment(clean, rirs, tmp_path / "out", noises=[more], point_noise_prob=1.0)
    assert {noise["id"] for row in rows_of(tmp_path / "out").values() for noise in row["noises"]} == {"fan"}
    with pytest.raises(ValueError, match="clean: no noises in it"):
        augment(clean, rirs, tmp_path / "out2", noises=[clean])


@pytest.mark.parametrize("text, quantiles", [
    ("uniform 5 25", {0.0: 5, 0.5: 15, 0.999: 24.98}), ("normal 15 5", {0.5: 15, 0.8413447: 20}),
    ("list 20,15,10", {0.0: 20, 0.34: 15, 0.99: 10}), ("list 20 15", {0.0: 20}), ("12.5", {0.3: 12.5}),
    (7, {0.9: 7}), ("uniform -5 5", {0.25: -2.5})])
def test_distribution_has_its_quantiles(text, quantiles):
    for u, value in quantiles.items():
        assert parse_distribution(text, "snr_db")(u) == pytest.approx(value, abs=1e-3)


@pytest.mark.parametrize("text", ["", "uniform", "uniform 5", "uniform 9 5", "normal 5 0", "list", "5 6", "gauss 1 2",
                                  "uniform a b", "nan", "uniform 5 inf", "1e9", "$(touch x)"])
def test_malformed_distribution_is_refused(text):
    with pytest.raises(ValueError, match="snr_db=.* must be 'uniform LOW HIGH'"):
        parse_distribution(text, "snr_db")


@pytest.mark.parametrize("options, message", [
    (dict(copies=2.0), r"copies=2.0 must be a whole number"), (dict(seed=1.5), "seed=1.5 must be a whole number"),
    (dict(max_point_noises="1"), "max_point_noises='1' must be"), (dict(point_noise_prob="a"), "prob='a' must lie in"),
    (dict(copies=0), "copies=0 must be at least 1"), (dict(point_noise_prob=1.5), r"point_noise_prob=1.5 must lie in"),
    (dict(max_point_noises=-1), "max_point_noises=-1"), (dict(packing="chapter"), "packing='chapter' must be"),
    (dict(snr_db="loud"), "snr_db='loud' must be"), (dict(part="0/2"), "part='0/2' must be JOB/JOBS")])
def test_option_out_of_range_is_refused(tmp_path, inputs, options, message):
    with pytest.raises(ValueError, match=message):
        augment(*inputs, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_bad_audio_is_named_and_the_old_output_kept(tmp_path, inputs):
    clean, rirs = inputs
    augment(clean, rirs, tmp_path / "out")
    before = bytes_of(tmp_path / "out")
    bad = clean / "wav/b-1-0001.flac"
    good = bad.read_bytes()
    for change, message in (
            (lambda: write_flac(bad, np.zeros(20011)), "utterance b-1-0001 with RIR room.* is silent"),
            (lambda: bad.write_bytes(good[:2000]), "utterance b-1-0001: .*b-1-0001.flac"),
            (lambda: soundfile.write(bad, np.zeros((20011, 2)), FS), "utterance b-1-0001: .*2 channels"),
            (lambda: bad.unlink(), "no such audio file")):
        change()
        with pytest.raises(ValueError, match=message) as caught:
            augment(clean, rirs, tmp_path / "out", seed=1)
        assert "\n" not in str(caught.value)
        assert bytes_of(tmp_path / "out") == before


def test_speech_that_16_bits_cannot_hold_is_refused(tmp_path, inputs):
    clean, rirs = inputs
    (clean / "wav/b-1-0001.flac").unlink()
    write_wav(tmp_path / "quiet.wav", 3e-6 * np.random.default_rng(0).standard_normal(LENGTHS["b-1-0001"]))
    scp = clean / "wav.scp"
    scp.write_text("".join(f"b-1-0001 {tmp_path}/quiet.wav\n" if line.startswith("b-1-0001 ") else line
                           for line in scp.read_text().splitlines(keepends=True)))
    with pytest.raises(ValueError, match="utterance b-1-0001: peak .*e-05 of .* rounds to 0 in 16 bits: raise"):
        augment(clean, rirs, tmp_path / "out", snr_db="none")


def test_order_that_the_suffix_of_copies_breaks_is_refused_before_audio_is_made(tmp_path, inputs, monkeypatch):
    clean = speech_dir(tmp_path / "talks", {"talk": 8000, "talk-2": 8000})
    for name in ("utt2spk", "spk2utt"):
        (clean / name).write_text("talk talk\ntalk-2 talk-2\n")
    (clean / "spk2gender").unlink(missing_ok=True)
    augment(clean, inputs[1], tmp_path / "one")
    monkeypatch.setattr(far_field, "_make_recording", lambda *_: pytest.fail("audio was made"))
    with pytest.raises(ValueError, match="copies=2: with the suffix -rvbN, utterance 'talk-2' of 'talk-2' sorts before "
                                         "'talk' of 'talk'.* rename utterance 'talk' so that no other id begins"):
        augment(clean, inputs[1], tmp_path / "out", copies=2)


@pytest.mark.parametrize("change, message", [
    (lambda d: write_flac(d / "wav/hum-room0.flac", np.zeros(2 * FS)), "noise hum-room0 is silent"),
    (lambda d: (d / "wav/hum-room0.flac").unlink(), "hum-room0.flac: no such audio file"),
    (lambda d: write_wav(d / "wav/room0-0.wav", np.zeros(4000)), "RIR room0-0 is silent"),
    (lambda d: write_wav(d / "wav/room0-0.wav", np.ones(10)), "10 samples where rirs.jsonl says 4000"),
    (lambda d: (d / "rirs.jsonl").unlink(), "rirs.jsonl: no such file"),
    (lambda d: write_rirs(d, [row | dict(noise_for="x") for row in read_rirs(d)]), "one for speech is needed")])
def test_bad_rirs_and_noises_are_named(tmp_path, change, message):
    clean, rirs = speech_dir(tmp_path / "clean", {f"s-{n:02d}": 500 for n in range(20)}), rir_dir(tmp_path / "rirs", 1)
    change(rirs)
    with pytest.raises(ValueError, match=message):
        augment(clean, rirs, tmp_path / "out")


def test_silent_part_of_a_noise_is_skipped(tmp_path):
    clean, rirs = speech_dir(tmp_path / "clean", {f"s-{n:02d}": 500 for n in range(20)}), rir_dir(tmp_path / "rirs", 1)
    write_flac(rirs / "wav/hum-room0.flac", np.r_[np.zeros(FS), burst(np.random.default_rng(0), FS)])
    augment(clean, rirs, tmp_path / "out")
    assert {noise["start"] > FS - 500 for row in rows_of(tmp_path / "out").values() for noise in row["noises"]
            if noise["kind"] == "ambient"} == {True}


def test_directory_not_made_by_roomeq_is_left_alone(tmp_path, inputs):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/thesis.tex").write_text("precious")
    with pytest.raises(ValueError, match="was not made by roomeq"):
        augment(*inputs, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]
    with pytest.raises(ValueError, match="line break"):
        augment(*inputs, tmp_path / "o\nut")


def test_kaldi_accepts_and_reads_the_result(tmp_path, inputs):
    root = Path(os.environ.get("KALDI_ROOT", "/nonexistent"))
    binary = root / "src/featbin/extract-segments"
    if not (binary.is_file() and shutil.which("flac")):
        pytest.skip("needs Kaldi's binaries and flac: set KALDI_ROOT")
    (tmp_path / "utils").symlink_to(root / "egs/wsj/s5/utils")
    (tmp_path / "path.sh").write_text("")
    augment(*inputs, tmp_path / "out it's", copies=2, point_noise_prob=1.0)
    (tmp_path / "out").symlink_to("out it's")  # Kaldi's scripts split on blanks, its wav.scp does not
    done = subprocess.run(["utils/validate_data_dir.sh", "--no-feats", "out"], cwd=tmp_path, capture_output=True,
                          text=True)
    assert "Successfully validated" in done.stdout + done.stderr
    subprocess.run([binary, "scp:out/wav.scp", "out/segments", "ark:out.ark"], cwd=tmp_path, check=True,
                   capture_output=True)
    result = read_data_dir(tmp_path / "out")
    for key, (fs_hz, pcm) in kaldiio.load_ark(str(tmp_path / "out.ark")):
        assert fs_hz == FS
        assert np.array_equal(pcm, np.rint(audio_of(result, key) * 32768))
