"""Exports: content by the rules of each format, independence of jobs, moved directories, refused input."""

import gzip
import json
import os
import shutil

import kaldiio
import numpy as np
import pytest
import soundfile
from datadirs import FS, LENGTHS, audio_of, decay, rir_dir, rir_row, speech_dir
from plans import L_PLAN, prism_obj

from roomeq.augment import augment
from roomeq.core.audio import write_wav
from roomeq.corpora.characterise import characterise
from roomeq.export import export
from roomeq.export.align import LEAD_S
from roomeq.kaldi.datadir import read_data_dir
from roomeq.records.rir_dir import read_noises, read_rirs, relocated, validate_rirs, write_noises, write_rirs
from roomeq.validate import validate

LEAD = round(LEAD_S * FS)
KINDS = ("lhotse", "espnet", "nemo", "huggingface")


def lines_of(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def lhotse_lines(path):
    return [json.loads(line) for line in gzip.decompress(path.read_bytes()).decode().splitlines()]


def bytes_of(directory):
    return {str(path.relative_to(directory)): path.read_bytes() for path in directory.rglob("*")
            if path.is_file() and path.name != ".done"}


def table(path):
    return dict(line.split(maxsplit=1) for line in path.read_text().splitlines())


def click_through(rir, shift):
    """Return where a click at sample 5000 begins after convolution, advanced by `shift`."""
    click = np.zeros(8000)
    click[5000] = 1.0
    return int(np.argmax(np.abs(np.convolve(click, rir)[shift:shift + len(click)])))


@pytest.fixture
def rirs(tmp_path):
    return rir_dir(tmp_path / "rirs", simulated=True)


@pytest.fixture
def far_field(tmp_path, rirs):
    augment(speech_dir(tmp_path / "clean"), rirs, tmp_path / "rvb")
    return tmp_path / "rvb"


def test_lhotse_manifests_state_recordings_and_segments(tmp_path, far_field):
    export("lhotse", far_field, tmp_path / "out")
    data = read_data_dir(far_field)
    recordings = {row["id"]: row for row in lhotse_lines(tmp_path / "out/recordings.jsonl.gz")}
    assert set(recordings) == set(data.recordings)
    for row in recordings.values():
        file = tmp_path / "out" / row["sources"][0]["source"]
        info = soundfile.info(file)
        assert (row["sampling_rate"], row["num_samples"], row["duration"]) == (FS, info.frames, info.frames / FS)
    snr, rir = table(far_field / "utt2snr"), table(far_field / "utt2rir")
    for row in lhotse_lines(tmp_path / "out/supervisions.jsonl.gz"):
        utterance = data.utterances[row["id"]]
        assert row["text"] == data.text[row["id"]]
        assert (row["speaker"], row["gender"]) == (utterance.speaker, data.spk2gender[utterance.speaker])
        assert row["custom"] == dict(rir=rir[row["id"]], snr_db=float(snr[row["id"]]), uniq=row["id"])
        samples, _ = soundfile.read(tmp_path / "out" / recordings[row["recording_id"]]["sources"][0]["source"])
        start = round(row["start"] * FS)
        np.testing.assert_array_equal(samples[start:start + round(row["duration"] * FS)], audio_of(data, row["id"]))


def test_noise_rirs_and_noises_have_manifests_of_their_own(tmp_path, rirs):
    rows = read_rirs(rirs)
    speech = [row["id"] for row in rows if not row.get("noise_for")]
    noise = [row["id"] for row in rows if row.get("noise_for")]
    export("lhotse", rirs, tmp_path / "lhotse")
    export("espnet", rirs, tmp_path / "espnet")
    export("nemo", rirs, tmp_path / "nemo")
    export("huggingface", rirs, tmp_path / "huggingface")
    for name, ids in dict(rirs=speech, noise_rirs=noise, ambient_noises=["hum-room0", "hum-room1"],
                          point_noises=["tap"]).items():
        assert [row["id"] for row in lhotse_lines(tmp_path / f"lhotse/{name}.jsonl.gz")] == ids
        assert list(table(tmp_path / f"espnet/{name}.scp")) == ids
        assert [row["id"] for row in lines_of(tmp_path / f"nemo/{name}.json")] == ids
        assert [row["id"] for row in lines_of(tmp_path / f"huggingface/{name}/metadata.jsonl")] == ids


@pytest.mark.parametrize("room, warned", [("2023-01-17", True), ("2023-01-17T10", True), ("2023-01-17-hall", False)])
def test_rooms_that_datasets_would_read_as_times_are_warned_of(tmp_path, room, warned, caplog):
    h = decay(np.random.default_rng(0))
    write_wav(tmp_path / "rirs/wav/a.wav", h)
    write_rirs(tmp_path / "rirs", [rir_row("a", room, h)])
    export("huggingface", tmp_path / "rirs", tmp_path / "out")
    assert ("datasets will read room_id of rirs as times" in caplog.text) == warned


def test_huggingface_leaves_out_acoustic_parameters_that_are_not_valid(tmp_path):
    h = decay(np.random.default_rng(0))
    write_wav(tmp_path / "rirs/wav/a.wav", h)
    parameters = dict(t20_s=[2.0] + [0.5] * 7, t20_valid=[False] + [True] * 7, c50_db=[3.0] * 8, drr_db=-2.0)
    write_rirs(tmp_path / "rirs", [rir_row("a", "hall", h) | dict(acoustic_parameters=parameters)])
    export("huggingface", tmp_path / "rirs", tmp_path / "out")
    (row,) = lines_of(tmp_path / "out/rirs/metadata.jsonl")
    assert row["t20_s"] == [None] + [0.5] * 7 and row["c50_db"] == [None] * 8
    assert row["t30_s"] is None and row["drr_db"] == -2.0


def test_directory_of_noises_is_exported(tmp_path, rirs):
    write_noises(tmp_path / "noises", relocated(read_noises(rirs), rirs, tmp_path / "noises"))
    for kind in (*KINDS, "roomeq"):
        export(kind, tmp_path / "noises", tmp_path / kind)
        assert sorted(path.name for path in (tmp_path / kind).rglob("*.flac")) == [
            "hum-room0.flac", "hum-room1.flac", "tap.flac"]
    assert not (tmp_path / "roomeq/rirs.jsonl").exists()


def test_click_stays_in_place_by_the_rule_of_each_toolkit(tmp_path, rirs):
    for kind in KINDS:
        export(kind, rirs, tmp_path / kind)
    for row in lhotse_lines(tmp_path / "lhotse/rirs.jsonl.gz"):
        h, _ = soundfile.read(tmp_path / "lhotse" / row["sources"][0]["source"])
        assert click_through(h, np.argmax(h)) == 5000  # lhotse advances by the largest sample
    for path in table(tmp_path / "espnet/rirs.scp").values():
        assert click_through(soundfile.read(path)[0], 0) == 5000 + LEAD  # ESPnet and NeMo advance by nothing
    for row in lines_of(tmp_path / "nemo/rirs.json"):
        assert click_through(soundfile.read(tmp_path / "nemo" / row["audio_filepath"])[0], 0) == 5000 + LEAD
    for row in lines_of(tmp_path / "huggingface/rirs/metadata.jsonl"):
        h, _ = soundfile.read(tmp_path / "huggingface/rirs" / row["file_name"])
        assert click_through(h, row["direct_sample"]) == 5000


def test_rir_that_lhotse_would_misalign_is_in_a_manifest_of_its_own(tmp_path, caplog):
    good, late = decay(np.random.default_rng(0), direct=100), decay(np.random.default_rng(1), direct=100)
    late[100 + 400], late[100 + 410] = 2.0, -1.9  # 25 ms later
    for name, h in dict(good=good, late=late).items():
        write_wav(tmp_path / f"rirs/wav/{name}.wav", h)
    write_rirs(tmp_path / "rirs", [rir_row("good", "r", good, direct_sample=100.0),
                                   rir_row("late", "r", late, direct_sample=100.0, suspicious=None)])
    caplog.set_level("INFO")
    export("lhotse", tmp_path / "rirs", tmp_path / "out")
    assert [row["id"] for row in lhotse_lines(tmp_path / "out/rirs.jsonl.gz")] == ["good"]
    assert [row["id"] for row in lhotse_lines(tmp_path / "out/late_rirs.jsonl.gz")] == ["late"]
    assert "1 of 2 RIRs are in late_rirs.jsonl.gz" in caplog.text


@pytest.mark.parametrize("rate_hz", [8000, 48000])
def test_rirs_of_any_rate_are_aligned(tmp_path, rate_hz):
    h = decay(np.random.default_rng(0), direct=300, n_samples=12000)
    write_wav(tmp_path / "rirs/wav/a.wav", h, rate_hz)
    write_rirs(tmp_path / "rirs", [rir_row("a", "r", h, fs_hz=rate_hz)])
    export("nemo", tmp_path / "rirs", tmp_path / "out")
    samples, found_hz = soundfile.read(tmp_path / "out/rirs/a.wav")
    assert (found_hz, int(np.argmax(np.abs(samples)))) == (rate_hz, round(LEAD_S * rate_hz))


def test_espnet_directory_needs_no_pipe_and_no_folder(tmp_path, far_field, monkeypatch):
    monkeypatch.chdir(tmp_path)
    export("espnet", "rvb", "out")
    monkeypatch.chdir("/")
    assert "|" not in (tmp_path / "out/wav.scp").read_text()
    data = read_data_dir(far_field)
    segments = kaldiio.load_scp(str(tmp_path / "out/wav.scp"), segments=str(tmp_path / "out/segments"))
    assert set(segments) == set(data.utterances)
    for key in data.utterances:
        rate, samples = segments[key]
        assert rate == FS
        np.testing.assert_array_equal(samples, audio_of(data, key))
    for name in ("text", "utt2spk", "spk2utt", "reco2dur", "utt2dur", "spk2gender", "utt2uniq"):
        assert (tmp_path / "out" / name).read_bytes() == (far_field / name).read_bytes()


def segmented(data, rows, n_samples=8 * FS):
    """Write a data directory with one recording `r1` of a speaker, and segments `UTTERANCE START END`."""
    rng = np.random.default_rng(0)
    write_wav(data / "r1.wav", 0.1 * rng.standard_normal(n_samples))
    write_wav(data / "r2.wav", 0.1 * rng.standard_normal(FS))
    (data / "wav.scp").write_text(f"r1 {data}/r1.wav\nr2 {data}/r2.wav\n")
    (data / "reco2dur").write_text(f"r1 {n_samples / FS}\nr2 1\n")
    (data / "segments").write_text("".join("{} r1 {} {}\n".format(*row.split()) for row in rows))
    (data / "utt2spk").write_text("".join(f"{row.split()[0]} s\n" for row in rows))
    return data


def test_espnet_segments_end_where_the_audio_does_and_unused_recordings_are_left_out(tmp_path):
    """Kaldi's validate_data_dir.sh takes no END of -1, and no recording without a segment."""
    data = segmented(tmp_path / "data", ["s-1 0.5 2", "s-2 2 -1"])
    export("espnet", data, tmp_path / "out")
    assert (tmp_path / "out/segments").read_text() == "s-1 r1 0.5 2.0\ns-2 r1 2.0 8.0\n"
    assert list(table(tmp_path / "out/wav.scp")) == list(table(tmp_path / "out/reco2dur")) == ["r1"]


@pytest.mark.parametrize("kind", KINDS)
def test_segment_without_a_sample_is_refused(tmp_path, kind):
    data = segmented(tmp_path / "data", ["s-1 1.000005 1.000015"])
    with pytest.raises(ValueError, match=r"segment from 1.000005 s to 1.000015 s holds no sample at 16000 Hz"):
        export(kind, data, tmp_path / "out")


@pytest.mark.parametrize("kind", ["espnet", "nemo"])
def test_times_give_the_samples_of_each_segment(tmp_path, kind):
    """Both toolkits cut at ``int(seconds * rate)``."""
    starts = [160 * n for n in range(100, 700)]
    ends = [start + 16005 + n for n, start in enumerate(starts)]
    data = segmented(tmp_path / "data", [f"s-{n:03d} {a / FS!r} {b / FS!r}" for n, (a, b) in
                                         enumerate(zip(starts, ends, strict=True))], n_samples=9 * FS)
    export(kind, data, tmp_path / "out")
    if kind == "nemo":
        rows = lines_of(tmp_path / "out/manifest.json")
        found = [(int(row["offset"] * FS), int(row["duration"] * FS)) for row in rows]
    else:
        times = [line.split()[2:] for line in (tmp_path / "out/segments").read_text().splitlines()]
        found = [(int(float(a) * FS), int(float(b) * FS) - int(float(a) * FS)) for a, b in times]
    assert found == [(a, b - a) for a, b in zip(starts, ends, strict=True)]


@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_several_channels_is_refused(tmp_path, kind):
    """Mixed into speech of one channel, it would make it multi-channel."""
    write_wav(tmp_path / "noises/n.wav", np.full((FS, 2), 0.1))
    write_noises(tmp_path / "noises", [dict(id="n", wav="n.wav", kind="ambient", room_id=None)])
    with pytest.raises(ValueError, match=r"n.wav: 2 channels where one is expected: split the file"):
        export(kind, tmp_path / "noises", tmp_path / "out")


def test_nemo_manifest_states_offsets_within_recordings(tmp_path, far_field):
    export("nemo", far_field, tmp_path / "out")
    data = read_data_dir(far_field)
    rows = lines_of(tmp_path / "out/manifest.json")
    assert [row["id"] for row in rows] == list(data.utterances)
    for row in rows:
        assert os.path.dirname(row["audio_filepath"]) and not os.path.isabs(row["audio_filepath"])
        samples, _ = soundfile.read(tmp_path / "out" / row["audio_filepath"])
        start = round(row["offset"] * FS)
        np.testing.assert_array_equal(samples[start:start + round(row["duration"] * FS)], audio_of(data, row["id"]))
        assert row["text"] == data.text[row["id"]]


def test_huggingface_has_one_file_per_utterance(tmp_path, far_field):
    export("huggingface", far_field, tmp_path / "out")
    data = read_data_dir(far_field)
    rows = lines_of(tmp_path / "out/speech/metadata.jsonl")
    assert {row["id"]: row["text"] for row in rows} == data.text
    for row in rows:
        samples, rate = soundfile.read(tmp_path / "out/speech" / row["file_name"])
        assert rate == FS
        np.testing.assert_array_equal(samples, audio_of(data, row["id"]))
    assert "config_name: speech" in (tmp_path / "out/README.md").read_text()


@pytest.mark.parametrize("kind", KINDS)
def test_directory_without_segments_is_exported(tmp_path, kind):
    export(kind, speech_dir(tmp_path / "clean"), tmp_path / "out")
    if kind == "lhotse":
        found = {row["id"]: row["duration"] for row in lhotse_lines(tmp_path / "out/supervisions.jsonl.gz")}
    elif kind == "espnet":
        found = {key: soundfile.info(path).frames / FS for key, path in table(tmp_path / "out/wav.scp").items()}
    else:
        name = "manifest.json" if kind == "nemo" else "speech/metadata.jsonl"
        found = {row["id"]: row["duration"] for row in lines_of(tmp_path / "out" / name)}
    assert found == {key: n / FS for key, n in LENGTHS.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_result_depends_neither_on_jobs_nor_on_where_it_lies(tmp_path, kind, rirs, far_field):
    for name, source in dict(rirs=rirs, far_field=far_field).items():
        export(kind, source, tmp_path / "a" / name)
        export(kind, source, tmp_path / "b" / name, nj=2)
        first, second = bytes_of(tmp_path / "a" / name), bytes_of(tmp_path / "b" / name)
        assert list(first) == list(second)
        for file, content in first.items():
            there = content if kind != "espnet" else content.replace(str(tmp_path / "a").encode(),
                                                                     str(tmp_path / "b").encode())
            assert there == second[file], file


def test_second_run_leaves_the_directory_alone(tmp_path, far_field, caplog):
    caplog.set_level("INFO")
    export("lhotse", far_field, tmp_path / "out")
    made = (tmp_path / "out/.done").stat().st_mtime_ns
    export("lhotse", far_field, tmp_path / "out")
    assert (tmp_path / "out/.done").stat().st_mtime_ns == made
    assert "up to date" in caplog.text


def test_lost_file_is_made_again(tmp_path, rirs):
    export("nemo", rirs, tmp_path / "out")
    before = bytes_of(tmp_path / "out")
    (tmp_path / "out/rirs/room0-0.wav").unlink()
    export("nemo", rirs, tmp_path / "out")
    assert bytes_of(tmp_path / "out") == before


def test_espnet_export_that_was_moved_is_made_anew(tmp_path, rirs):
    export("espnet", rirs, tmp_path / "out")
    (tmp_path / "out").rename(tmp_path / "moved")
    export("espnet", rirs, tmp_path / "moved")
    assert all(path.startswith(str(tmp_path / "moved")) for path in table(tmp_path / "moved/rirs.scp").values())


def test_links_lead_to_audio_that_stays_as_it_is(tmp_path, rirs, far_field):
    export("lhotse", far_field, tmp_path / "speech", link=True)
    linked = sorted((tmp_path / "speech/recordings").rglob("*.flac"))
    assert linked and all(path.is_symlink() and path.resolve().is_relative_to(far_field) for path in linked)
    export("lhotse", rirs, tmp_path / "rirs.out", link=True)
    assert not any(path.is_symlink() for path in (tmp_path / "rirs.out/rirs").iterdir())  # cut: another content
    assert all(path.is_symlink() for path in (tmp_path / "rirs.out/ambient_noises").iterdir())
    made = (tmp_path / "speech/.done").stat().st_mtime_ns
    export("lhotse", far_field, tmp_path / "speech", link=True)
    assert (tmp_path / "speech/.done").stat().st_mtime_ns == made


def test_archive_is_decoded(tmp_path):
    data = tmp_path / "data"
    speech_dir(data)
    audio = {key: soundfile.read(data / f"wav/{key}.flac", dtype="int16")[0] for key in LENGTHS}
    kaldiio.save_ark(str(data / "wav.ark"), {key: (FS, samples) for key, samples in audio.items()},
                     scp=str(data / "wav.scp"))
    export("espnet", data, tmp_path / "out")
    for key, path in table(tmp_path / "out/wav.scp").items():
        np.testing.assert_array_equal(soundfile.read(path, dtype="int16")[0], audio[key])


@pytest.mark.parametrize("format_, suffix", [("NIST", ".nist"), ("WAVEX", ".wav"), ("AIFF", ".aiff")])
def test_suffix_is_one_by_which_toolkits_choose_libsndfile(tmp_path, format_, suffix):
    """lhotse passes .sph to sph2pipe, NeMo to FFmpeg."""
    data = segmented(tmp_path / "data", ["s-1 0 8"])
    soundfile.write(data / "r1.wav", np.full(FS, 0.1), FS, format=format_, subtype="PCM_16")
    (data / "segments").write_text("s-1 r1 0 1\n")
    export("lhotse", data, tmp_path / "out")
    assert [path.suffix for path in (tmp_path / "out/recordings").rglob("r1*")] == [suffix]


@pytest.mark.parametrize("kind", ["nemo", "lhotse"])
def test_utterance_with_the_id_of_another_recording_keeps_its_own_audio(tmp_path, kind):
    data = speech_dir(tmp_path / "data")
    first, second = list(LENGTHS)[:2]
    speaker = table(data / "utt2spk")[first].strip()
    for name, lines in {"utt2spk": [f"{first} {speaker}", f"{second} {speaker}"],
                        "text": [f"{first} ONE", f"{second} TWO"],
                        "segments": [f"{first} {second} 0.10 0.30", f"{second} {first} 0.20 0.30"],
                        "wav.scp": [line for line in (data / "wav.scp").read_text().splitlines()
                                    if line.split()[0] in (first, second)]}.items():
        (data / name).write_text("".join(f"{line}\n" for line in lines))
    for name in ("spk2utt", "spk2gender", "utt2dur", "reco2dur"):
        (data / name).unlink(missing_ok=True)
    export(kind, data, tmp_path / "out")
    if kind == "nemo":
        found = {row["id"]: (os.path.basename(row["audio_filepath"]), row["offset"], row["duration"])
                 for row in lines_of(tmp_path / "out/manifest.json")}
        assert found == {first: (f"{second}.flac", 0.1, 0.2), second: (f"{first}.flac", 0.2, 0.1)}
    else:
        rows = lhotse_lines(tmp_path / "out/supervisions.jsonl.gz")
        assert {row["id"]: row["recording_id"] for row in rows} == {first: second, second: first}


def test_command_keeps_rate_and_bits(tmp_path):
    rng = np.random.default_rng(4)
    wav, pcm = tmp_path / "fine.wav", rng.integers(-2 ** 22, 2 ** 22, 24000) << 8
    soundfile.write(wav, pcm.astype(np.int32), 48000, subtype="PCM_24")
    data = tmp_path / "data"
    data.mkdir()
    for name, line in {"wav.scp": f"a cat {wav} |", "utt2spk": "a a", "text": "a ONE"}.items():
        (data / name).write_text(line + "\n")
    export("nemo", data, tmp_path / "out", pipes=True)
    (made,) = (tmp_path / "out").rglob("*.flac")
    samples, rate = soundfile.read(made, dtype="int32")
    assert rate == 48000
    np.testing.assert_array_equal(samples, pcm)
    soundfile.write(wav, 1.8 * np.sin(np.arange(24000.0)), 48000, subtype="FLOAT")
    with pytest.raises(ValueError, match=r"a: cat .*: peak 1\.8 must be at most 1 in a FLAC file: scale"):
        export("nemo", data, tmp_path / "loud", pipes=True)
    wav.write_bytes(wav.read_bytes()[:-8000])
    with pytest.raises(ValueError, match=r"cat .*truncated: \d+ bytes of \d+"):
        export("nemo", data, tmp_path / "cut", pipes=True)


@pytest.mark.parametrize("kind, said", [
    ("nemo", "1 of 1 RIRs are of arrays: nemo gets that of the first microphone"),
    ("huggingface", "1 RIRs are of arrays: where `datasets` decodes them, it averages the channels"), ("roomeq", "")])
def test_export_that_takes_one_microphone_of_an_array_says_so(tmp_path, kind, said, caplog):
    rng = np.random.default_rng(0)
    rir = np.column_stack([decay(rng), decay(rng)])
    write_wav(tmp_path / "rirs/wav/a.wav", rir)
    write_rirs(tmp_path / "rirs", [rir_row("a", "room", rir, direct_sample=100.0, mic_pos_m=[1.0, 1.0, 1.0],
                                           channel_pos_m=[[1.0, 1.0, 1.0], [1.1, 1.0, 1.0]])])
    export(kind, tmp_path / "rirs", tmp_path / "out")
    assert said in caplog.text and (said or "arrays" not in caplog.text)


def test_snr_that_is_no_number_is_refused_by_its_line(far_field, tmp_path):
    table = far_field / "utt2snr"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0].split()[0] + " high", *lines[1:]]) + "\n")
    (far_field / ".done").unlink()
    with pytest.raises(ValueError, match=r"utt2snr:1: value 'high' of .* must be a number of decibels, or inf"):
        export("nemo", far_field, tmp_path / "out")


def test_suspicious_recording_is_left_out(tmp_path, rirs):
    rows = read_rirs(rirs)
    rows[0]["suspicious"] = "clipped"
    write_rirs(rirs, rows)
    export("nemo", rirs, tmp_path / "out")
    assert rows[0]["id"] not in [row["id"] for row in lines_of(tmp_path / "out/rirs.json")]


def test_recording_that_is_no_rir_is_copied_with_its_directory(tmp_path):
    """`roomeq export roomeq` leaves nothing out, and states no direct sound."""
    noise = 0.1 * np.random.default_rng(0).standard_normal(16000)
    write_wav(tmp_path / "rirs/wav/a.wav", noise)
    write_rirs(tmp_path / "rirs", [rir_row("a", "room", noise, suspicious="no decay")])
    export("roomeq", tmp_path / "rirs", tmp_path / "out")
    assert [row["suspicious"] for row in read_rirs(tmp_path / "out")] == ["no decay"]


def test_moved_rir_directory_is_used_as_before(tmp_path, rirs):
    clean = speech_dir(tmp_path / "clean")
    augment(clean, rirs, tmp_path / "x/rvb")
    export("lhotse", rirs, tmp_path / "x/out")
    (tmp_path / "elsewhere").mkdir()
    moved = rirs.rename(tmp_path / "elsewhere/moved")
    assert validate_rirs(moved) == 6
    augment(clean, moved, tmp_path / "y/rvb")
    export("lhotse", moved, tmp_path / "y/out")
    assert bytes_of(tmp_path / "x/out") == bytes_of(tmp_path / "y/out")
    first, second = bytes_of(tmp_path / "x/rvb"), bytes_of(tmp_path / "y/rvb")
    assert {name: content.replace(b"/y/rvb", b"/x/rvb") for name, content in second.items()} == first


def test_directories_that_refer_to_each_other_are_moved_together(tmp_path, rirs):
    clean = speech_dir(tmp_path / "clean")
    characterise(rirs.rename(tmp_path / "tree"), tmp_path / "tree.real")
    (tmp_path / "elsewhere").mkdir()
    for name in ("tree", "tree.real"):
        (tmp_path / name).rename(tmp_path / "elsewhere" / name)
    moved = tmp_path / "elsewhere/tree.real"
    validate([moved])
    augment(clean, moved, tmp_path / "rvb")
    export("nemo", moved, tmp_path / "out")


def test_directory_that_refers_to_others_is_copied_whole(tmp_path, rirs):
    source = tmp_path / "referring"
    write_rirs(source, [row | dict(suspicious="clipped") if row["id"] == "room1-1" else row
                        for row in relocated(read_rirs(rirs), rirs, source)])
    write_noises(source, relocated(read_noises(rirs), rirs, source))
    export("roomeq", source, tmp_path / "copy")
    shutil.rmtree(rirs)
    shutil.rmtree(source)
    moved = (tmp_path / "copy").rename(tmp_path / "moved")
    assert validate_rirs(moved) == 6
    validate([moved])
    augment(speech_dir(tmp_path / "clean"), moved, tmp_path / "rvb")


def test_meshes_are_copied_with_their_rirs(tmp_path):
    h = decay(np.random.default_rng(0))
    write_wav(tmp_path / "rirs/wav/a.wav", h)
    (tmp_path / "room.obj").write_text(prism_obj(L_PLAN, 3.0, "brick_bare"))
    write_rirs(tmp_path / "rirs", [rir_row("a", "r", h, mesh="../room.obj", suspicious=None)])
    export("roomeq", tmp_path / "rirs", tmp_path / "out")
    mesh = tmp_path / "out" / read_rirs(tmp_path / "out")[0]["mesh"]
    assert mesh.read_bytes() == (tmp_path / "room.obj").read_bytes()
    (tmp_path / "room.obj").write_text(prism_obj(L_PLAN, 3.5, "brick_bare"))
    export("roomeq", tmp_path / "rirs", tmp_path / "out")
    assert mesh.read_bytes() == (tmp_path / "room.obj").read_bytes()


def test_directory_moved_without_its_audio_says_what_to_do(tmp_path, rirs):
    characterise(rirs, tmp_path / "real")
    (tmp_path / "elsewhere").mkdir()
    moved = (tmp_path / "real").rename(tmp_path / "elsewhere/real")
    with pytest.raises(ValueError, match="missing since .* move it back and copy it with roomeq export roomeq"):
        augment(speech_dir(tmp_path / "clean"), moved, tmp_path / "rvb")


def test_folder_of_another_kind_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty: neither an RIR directory .* nor a data directory .*: check the path"):
        export("lhotse", tmp_path / "empty", tmp_path / "out")
    with pytest.raises(ValueError, match="kind='kaldi' must be one of lhotse, espnet, nemo, huggingface, roomeq"):
        export("kaldi", tmp_path / "empty", tmp_path / "out")
    with pytest.raises(ValueError, match="clean: kind=roomeq must be given an RIR directory"):
        export("roomeq", speech_dir(tmp_path / "clean"), tmp_path / "out")


def test_broken_audio_is_refused_by_name(tmp_path, far_field, rirs):
    file = next((far_field / "audio").rglob("*.flac"))
    file.write_bytes(file.read_bytes()[:-100])
    (far_field / ".done").unlink()
    with pytest.raises(ValueError, match=file.name):
        export("lhotse", far_field, tmp_path / "out")
    (rirs / "wav/room0-0.wav").unlink()
    with pytest.raises(ValueError, match=r"room0-0.wav: no such audio file"):
        export("nemo", rirs, tmp_path / "out2")
    assert not (tmp_path / "out").exists() and not (tmp_path / "out2").exists()


def test_rir_that_does_not_fit_its_row_is_refused(tmp_path, rirs):
    write_wav(rirs / "wav/room0-0.wav", np.zeros(4000))
    with pytest.raises(ValueError, match="RIR room0-0 is silent"):
        export("lhotse", rirs, tmp_path / "out")
    write_wav(rirs / "wav/room0-0.wav", np.ones(3999))
    with pytest.raises(ValueError, match="3999 samples where rirs.jsonl says 4000: make it again"):
        export("huggingface", rirs, tmp_path / "out")


def test_foreign_directory_is_not_replaced(tmp_path, rirs):
    shutil.copytree(rirs, tmp_path / "out")
    with pytest.raises(ValueError, match="was not made by roomeq"):
        export("lhotse", rirs, tmp_path / "out")
