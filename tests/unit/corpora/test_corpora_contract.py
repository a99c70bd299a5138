"""Rules that every kind of measured corpus obeys."""

import json
import logging
from itertools import product

import numpy as np
import pytest
import soundfile
from corpora_examples import MEASURED, make_folder, make_table, put, put_text, rir

from roomeq.core.audio import read_audio
from roomeq.core.digests import digest
from roomeq.core.files import read_json
from roomeq.corpora import prepare_speech, read_measured
from roomeq.corpora import read_noises as read_noise_folder
from roomeq.corpora.listing import detect_kind
from roomeq.corpora.record import audio_files, rir_row
from roomeq.export import export
from roomeq.records.rir_dir import load_rir, read_noises, read_rirs, validate_rirs
from roomeq.records.schema import is_id

N_RIRS = dict(reverbdb=2, table=2, folder=4, slr28=13, sofa=5)


@pytest.fixture(params=MEASURED)
def corpus(request, tmp_path):
    return request.param, MEASURED[request.param](tmp_path / "some corpus")


def test_every_kind_is_recognised_and_keeps_the_contract(corpus, tmp_path):
    kind, source = corpus
    assert detect_kind(source) == kind
    out = read_measured(source, tmp_path / "out" / "measured")
    assert validate_rirs(out) == N_RIRS[kind]
    for row in read_rirs(out):
        assert set(rir_row()) <= set(row)
        assert all(is_id(row[key]) for key in ("id", "room_id", "source_id", "mic_id"))
        assert isinstance(row["binaural"], bool) and isinstance(row["unreliable_geometry"], bool)
        assert not row["wav"].startswith("/")
        assert len(load_rir(out, row)) == row["n_samples"]
    for noise in read_noises(out):
        assert noise["duration_s"] > 0 and read_audio(out / noise["wav"]).any()
    assert json.loads((out / "corpus.json").read_text())["rirs"] == N_RIRS[kind]


def test_two_jobs_give_the_same_bytes(corpus, tmp_path):
    kind, source = corpus
    outs = [read_measured(source, tmp_path / f"out{n}", nj=n) for n in (1, 2)]
    names = [{path.relative_to(out): path.read_bytes() for path in sorted(out.rglob("*"))
              if path.is_file() and path.name not in (".done", "rir_list")} for out in outs]
    assert names[0] == names[1] and len(names[0]) >= 3


def test_output_is_remade_only_for_a_changed_corpus(tmp_path):
    source = make_folder(tmp_path / "rooms")
    out = read_measured(source, tmp_path / "out")
    made = (out / "rirs.jsonl").stat().st_mtime_ns
    assert (read_measured(source, out) / "rirs.jsonl").stat().st_mtime_ns == made
    put(source / "hall" / "new.wav")
    assert len(read_rirs(read_measured(source, out))) == 5
    with pytest.raises(ValueError, match="out: is an RIR directory already"):
        read_measured(out, tmp_path / "again")


def test_audio_beside_the_files_of_a_step_counts(tmp_path):
    measured = read_measured(make_folder(tmp_path / "rooms"), tmp_path / "measured")
    export("huggingface", measured, tmp_path / "set")
    n_rirs = len(read_rirs(read_measured(tmp_path / "set", tmp_path / "out")))
    for n_samples in (800, 900):  # added, then replaced
        put(tmp_path / "set/rirs/added.wav", rir("added", n_samples))
        rows = read_rirs(read_measured(tmp_path / "set", tmp_path / "out"))
        assert {row["id"]: row["n_samples"] for row in rows}["rirs-added"] == n_samples
        assert len(rows) == n_rirs + 1


@pytest.mark.parametrize("linked", [".", "kitchen"])
def test_rirs_are_found_where_a_link_leads_now(linked, tmp_path):
    put(tmp_path / "disk1/kitchen/one.wav", rir("one", 800))
    link = tmp_path / "rooms" / linked
    link.parent.mkdir(exist_ok=True)
    for disk in ("disk1", "disk2"):
        if disk == "disk2":
            link.unlink()
            (tmp_path / "disk1").rename(tmp_path / "disk2")
        link.symlink_to(tmp_path / disk / linked)
        digest(read_measured(tmp_path / "rooms", tmp_path / "out", keep_suspicious=True))


def test_changed_audio_of_a_table_remakes_the_output(tmp_path):
    table = make_table(tmp_path / "home" / "corpus") / "manifest.csv"
    out = read_measured(table, tmp_path / "out")
    made = (out / "rirs.jsonl").stat().st_mtime_ns
    put(tmp_path / "home" / "corpus" / "unlisted.wav")
    assert (read_measured(table, out) / "rirs.jsonl").stat().st_mtime_ns == made
    put(tmp_path / "home" / "corpus" / "rirs" / "lab" / "one.flac", rir("longer", 900))
    assert read_rirs(read_measured(table, out))[0]["n_samples"] == 900


def test_audio_of_every_suffix_is_read_and_other_audio_is_counted(tmp_path, caplog):
    formats = dict(ogg="OGG", oga="OGG", opus="OGG", aifc="AIFF", rf64="RF64", sph="NIST", nist="NIST", mp3="MP3",
                   wave="WAV", flac="FLAC", w64="W64", caf="CAF", au="AU")
    for suffix, fmt in formats.items():
        path = put_text(tmp_path / f"rooms/kitchen/{suffix}.{suffix}", "")
        soundfile.write(path, rir(suffix, 8000), 16000, format=fmt, subtype="OPUS" if suffix == "opus" else None)
    for name in ("a.m4a", "b.WMA", "notes.txt"):
        put_text(tmp_path / "rooms/kitchen" / name, "")
    out = read_measured(tmp_path / "rooms", tmp_path / "out", keep_suspicious=True)
    assert {row["id"] for row in read_rirs(out)} == {f"kitchen-{suffix}" for suffix in formats}
    assert "rooms: 2 files are left out, as audio of their format is not read (the first: kitchen/a.m4a)" in caplog.text
    assert caplog.text.count("left out") == 1


def test_folders_below_that_of_a_room_are_no_rooms(tmp_path):
    for room, place in product(("attic", "kitchen"), ("near", "far")):
        put(tmp_path / "rooms" / room / place / "one.wav", rir(room + place))
    out = read_measured(tmp_path / "rooms", tmp_path / "out")
    assert {row["id"]: row["room_id"] for row in read_rirs(out)} == {
        f"{room}-{place}-one": room for room in ("attic", "kitchen") for place in ("near", "far")}
    assert read_json(out / "corpus.json")["notes"] == {"RIR in a folder of a folder of rooms, which is taken for the "
                                                       "room": 4}


def test_last_bit_of_a_response_is_not_resampled(tmp_path):
    decay = 2.0 ** -8 * np.random.default_rng(0).standard_normal(48000) * 10.0 ** (-3.0 * np.arange(48000) / 9600.0)
    for name, subtype in (("quiet", "PCM_16"), ("exact", "PCM_24")):
        put(tmp_path / "rooms" / "kitchen" / f"{name}.wav", np.floor(2.0 ** 15 * decay) / 2.0 ** 15 if name == "quiet"
            else decay, 48000, subtype)
    rows = {row["id"]: row for row in read_rirs(read_measured(tmp_path / "rooms", tmp_path / "out"))}
    assert 0.1 < rows["kitchen-quiet"]["n_samples"] / 16000 < 0.2
    assert rows["kitchen-exact"]["n_samples"] > 0.2 * 16000


def test_dithered_silence_behind_a_cut_is_not_resampled(tmp_path):
    rng, n_samples = np.random.default_rng(0), round(0.41 * 48000)
    noisy = rng.standard_normal(n_samples) * (10.0 ** (-3.0 * np.arange(n_samples) / 9600.0) + 0.005)
    dither = rng.uniform(-0.5, 0.5, (2, 48000)).sum(axis=0)
    steps = np.round(2.0 ** 13 * np.pad(noisy, (0, 48000 - n_samples)) / np.abs(noisy).max() + dither)
    put(tmp_path / "rooms" / "kitchen" / "cut.wav", steps / 2.0 ** 15, 48000, "PCM_16")
    row, = read_rirs(read_measured(tmp_path / "rooms", tmp_path / "out"))
    assert 0.4 < row["n_samples"] / 16000 <= 0.41


def test_16_khz_mono_is_referenced_other_audio_converted(tmp_path):
    out = read_measured(make_folder(tmp_path / "rooms"), tmp_path / "out")
    rows = {row["id"]: row for row in read_rirs(out)}
    assert rows["kitchen-near"]["wav"] == "../rooms/kitchen/near.wav"
    assert rows["kitchen-near"]["room_id"] == "kitchen" and rows["kitchen-near"]["source_pos_m"] is None
    assert rows["hall-hall_44k"]["wav"] == "wav/hall-hall_44k.wav"
    assert rows["hall-hall_44k"]["n_samples"] == round(2000 * 16000 / 44100)
    channels = [rows[f"kitchen-far-stereo_ch{n}"] for n in (0, 1)]
    assert [row["mic_id"] for row in channels] == ["ch0", "ch1"]
    assert load_rir(out, channels[1]) == pytest.approx(rir("stereo", channels=2)[:, 1], abs=1e-4)
    # 32-bit float: the converted copy is the 16-bit file to the bit
    assert (load_rir(out, channels[0]) == read_audio(tmp_path / "rooms/kitchen/far stereo.wav", channel=0)).all()


def test_converted_and_copied_files_are_counted(tmp_path, caplog):
    caplog.set_level("INFO")
    put(tmp_path / "corpus/a room/one.wav", rir("one"))
    put(tmp_path / "corpus/a room/two.wav", rir("two"))
    put(tmp_path / "corpus/plain/pair.wav", rir("pair", channels=2))
    put(tmp_path / "corpus/plain/three.wav", rir("three"))
    read_measured(tmp_path / "corpus", tmp_path / "out")
    assert "1 files converted to 16000 Hz mono, 2 copied (path with blanks or special characters), 0" in caplog.text
    assert "corpus: 1 files have several channels: each channel is an RIR of its own" in caplog.text


def test_one_position_for_several_channels_is_said(tmp_path, caplog):
    put(tmp_path / "corpus/pair.wav", rir("pair", channels=2))
    put(tmp_path / "corpus/one.wav", rir("one"))
    put(tmp_path / "corpus/one_ch1.wav", rir("other"))  # a file of its own
    (tmp_path / "corpus/manifest.csv").write_text(
        "file,room,room_dims_m,source_pos_m,mic_pos_m\npair.wav,a,5 4 3,1 1 1,3 2 1\none.wav,a,5 4 3,1 1 1,2 2 1\n"
        "one_ch1.wav,a,5 4 3,1 1 1,1 2 1\n")
    rows = read_rirs(read_measured(tmp_path / "corpus", tmp_path / "out"))
    assert [row["mic_pos_m"] for row in rows if "pair" in row["id"]] == [[3.0, 2.0, 1.0]] * 2
    assert "files with several channels, all of which have the one stated microphone position: 1 (first" in caplog.text


def test_file_that_is_listed_twice_is_refused_with_its_lines(tmp_path):
    put(tmp_path / "a.wav", rir("a"))
    put_text(tmp_path / "manifest.csv", "file,room\na.wav,hall\na.wav,hall\n")
    with pytest.raises(ValueError, match=r"manifest\.csv:3: .*/a\.wav is listed twice \(first in .*manifest\.csv:2\): "
                                         "list every file once"):
        read_measured(tmp_path, tmp_path / "out")


def test_log_says_where_geometry_contradicts_itself(tmp_path, caplog):
    lines = ["wav0.wav,a,5 4 3,7 1 1,3 2 1,", "wav1.wav,a,5 4 3,1 1 1,3 2 1,9"]
    lines += [f"wav{n}.wav,a,5 4 3,1 1 1,{5 + n} 2 1," for n in range(2, 7)] + ["wav7.wav,a,5 4 3,7 1 1,3 2 1,"]
    for n in range(len(lines)):
        put(tmp_path / f"corpus/wav{n}.wav", rir(str(n)))
    put_text(tmp_path / "corpus/manifest.csv",
             "\n".join(["file,room,room_dims_m,source_pos_m,mic_pos_m,distance_m", *lines, ""]))
    read_measured(tmp_path / "corpus", tmp_path / "out")
    problems = [message for message in caplog.messages if "positions" in message]
    assert len(problems) == 6
    assert problems[0].endswith("manifest.csv:2: source_pos_m[0]=7 lies outside the room (0 to 5 m): the positions are "
                                "not used: correct the geometry")
    assert "manifest.csv:3: distance_m=9 but the positions are 2.24 m apart" in problems[1]
    assert problems[5] == "corpus: positions of 3 more recordings are not used: see geometry_problem in rirs.jsonl"


def test_rooms_of_different_sizes_under_one_name_are_said(tmp_path, caplog):
    for name in ("0.wav", "a.wav", "b.wav", "c.wav"):
        put(tmp_path / "mic" / name)
    put_text(tmp_path / "mic/manifest.csv",
             "file,room,room_dims_m\n0.wav,A,?\na.wav,A,9.7 5.5 2.7\nb.wav,A,8 5.5 2.7\n")
    caplog.set_level(logging.INFO)
    read_measured(tmp_path / "mic", tmp_path / "out")
    assert ("room A: RIR a states room_dims_m=[9.7, 5.5, 2.7], and RIR b [8.0, 5.5, 2.7] (1 such rooms)"
            in caplog.text)
    assert "1 audio files below its folder are not in it, and are not read (the first: c.wav)" in caplog.text


def test_relative_paths_hold_through_links(tmp_path):
    source = make_table(tmp_path / "disk" / "deep" / "corpus")
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    (tmp_path / "linked corpus").symlink_to(source)
    assert validate_rirs(read_measured(tmp_path / "linked corpus", tmp_path / "link" / "out")) == 2


def test_noises_are_added(tmp_path):
    put(tmp_path / "noise" / "room_tone_home.wav")
    put(tmp_path / "noise" / "dishes 44k.wav", rir("noise", 4410), fs_hz=44100)
    out = read_measured(make_table(tmp_path / "corpus"), tmp_path / "out", noises=tmp_path / "noise")
    noises = {noise["id"]: noise for noise in read_noises(out)}
    assert {name: noise["kind"] for name, noise in noises.items()} == {"dishes-44k": "point",
                                                                       "room_tone_home": "ambient"}
    assert noises["dishes-44k"]["duration_s"] == pytest.approx(0.1)


def test_changed_table_counts_where_its_folder_is_that_of_the_noises_too(tmp_path):
    source = make_table(tmp_path / "corpus")
    read_measured(source, tmp_path / "out", noises=source)
    manifest = source / "manifest.csv"
    put_text(manifest, manifest.read_text().replace(",1.50,", ",1.52,"))
    rows = read_rirs(read_measured(source, tmp_path / "out", noises=source))
    assert [row["distance_m"] for row in rows] == [1.52, None]


def test_synthetic_corpus_is_read_with_its_defects(project_dir, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(project_dir / "local"))
    import make_synthetic_rirs

    corpus = make_synthetic_rirs.Corpus(rooms=3, mics=2, speakers=2, silence_s=1, seed=0)
    make_synthetic_rirs.make_synthetic_rirs(tmp_path / "synthetic", corpus)
    out = read_measured(tmp_path / "synthetic", tmp_path / "out")
    rows = read_rirs(out)
    assert validate_rirs(out) == len(rows) == 16
    assert sum(row["repeat_of"] is not None for row in rows) == 4  # two second takes, two of a _T session
    assert {row["room_id"] for row in rows if row["uncommon"]} == {"Standin_Stairs_S3"}
    problems = [row["geometry_problem"] for row in rows if row["unreliable_geometry"]]
    assert len(problems) == 2 and all("lies outside the room" in problem for problem in problems)
    assert all(row["room_dims_m"] and row["temperature_c"] and row["corpus"] == "synthetic" for row in rows)
    assert len(read_noises(out)) == 7


def test_shared_recordings(shared_data, tmp_path):
    out = read_measured(shared_data / "measured", tmp_path / "out", noises=shared_data / "noise")
    rows = read_rirs(out)
    assert validate_rirs(out) == 213 and len({row["room_id"] for row in rows}) == 18
    assert sum(row["binaural"] for row in rows) == 12
    assert sorted(row["id"].split("__")[1] for row in rows if row["excitation"] == "clap") == [
        "brir_clap_L", "brir_clap_R", "rir_clap"]
    unreliable = [row["room_id"] for row in rows if row["unreliable_geometry"]]
    assert unreliable == ["BUT_Hotel_SkalskyDvur_ConferenceRoom2"]
    heights = [row["source_pos_m"][2] for row in rows if row["corpus"] == "R3VIVAL"]
    assert heights == [None] * 170
    q301 = next(row for row in rows if row["room_id"] == "BUT_VUT_FIT_Q301")
    assert q301["room_dims_m"] == [10.78, 6.94, 2.60] and q301["mic_pos_m"] == [1.75, 4.12, 1.23]
    noises = read_noises(out)
    assert len(noises) == 19 and sum(noise["kind"] == "point" for noise in noises) == 2


def test_outputs_below_a_source_are_not_read_again(tmp_path, caplog):
    source = make_folder(tmp_path / "rooms")
    first = read_rirs(read_measured(source, source / "out"))
    caplog.set_level("INFO")
    assert read_rirs(read_measured(source, source / "out")) == first and "up to date" in caplog.text
    assert f"({source / 'out'}) are left out" in caplog.text
    put(source / "foreign" / "a.wav", rir("another"))
    put_text(source / "foreign" / ".done", "")
    assert len(read_rirs(read_measured(source, source / "out"))) == len(first) + 1
    noises = put(tmp_path / "noises" / "hum.wav").parent
    assert [len(read_noises(read_noise_folder(noises, noises / "out"))) for _ in range(2)] == [1, 1]


@pytest.mark.parametrize("suffix", ["xlsx", "XLS", "ods"])
@pytest.mark.parametrize("read", [read_measured, read_noise_folder, prepare_speech])
def test_spreadsheets_are_refused(tmp_path, suffix, read):
    sheet = put_text(put(tmp_path / "corpus" / "a.wav").parent / f"rirs.{suffix}", "PK")
    with pytest.raises(ValueError, match=rf"rirs\.{suffix}: is a spreadsheet, .*: export it as CSV$"):
        read(sheet, tmp_path / "out")
    sheet.rename(sheet.with_name(f"manifest.{suffix.lower()}"))
    with pytest.raises(ValueError, match=r"manifest\.\w+: is a spreadsheet, .* as CSV, called manifest\.csv"):
        read(sheet.parent, tmp_path / "out")


def test_a_stamped_source_is_read_itself(tmp_path):
    made = read_measured(make_folder(tmp_path / "rooms"), tmp_path / "out")
    assert len(audio_files(made)) == len(list(made.rglob("*.wav"))) > 0
