"""Clean speech becomes Kaldi data directories."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from corpora_examples import put, put_librispeech, put_text, rir

from roomeq.augment import augment
from roomeq.core.digests import digest
from roomeq.corpora import prepare_speech, read_measured
from roomeq.corpora.characterise import characterise
from roomeq.corpora.kaldi_dir import KaldiDir
from roomeq.corpora.librispeech import read_genders
from roomeq.corpora.utterance import split_voices
from roomeq.export import export
from roomeq.kaldi.validate import validate_data_dir

SETS = {"train-clean-100": {"19": {"198": 2, "227": 1}}, "train-clean-360": {"100": {"1": 1}},
        "dev-clean": {"1272": {"128104": 2}}, "test-clean": {"61": {"70968": 1}}}
ROLES = dict(train_sets=("train-clean-100", "train-clean-360"), dev_sets=("dev-clean",), test_sets=("test-clean",))


def lines(path):
    return path.read_text().splitlines()


def table(path):
    return dict(line.split(maxsplit=1) for line in lines(path))


def put_manifest(root, rows, columns="file,utt_id,speaker,transcript"):
    for row in rows:
        put(root / row.split(",")[0], rir(row, 1600))
    put_text(root / "manifest.csv", "\n".join([columns, *rows]) + "\n")
    return root


def rows_of_voices(counts):
    return [f"{voice}/{n}.flac,{voice}-{n},{voice},WORDS {n}" for voice, count in counts.items()
            for n in range(count)]


def test_folders_of_speakers_may_be_links_and_their_names_may_begin_alike(tmp_path):
    for n, speaker in enumerate(("Anna", "Anna Maria", "Bob", "Carl")):
        put(tmp_path / "disk" / speaker / "a.flac", rir(f"{n}", 1600))
        put(tmp_path / "disk" / speaker / "Z.flac", rir(f"{n}z", 1600))
    (tmp_path / "speech").mkdir()
    for speaker in ("Anna", "Anna Maria", "Bob", "Carl"):
        os.symlink(tmp_path / "disk" / speaker, tmp_path / "speech" / speaker)
    prepare_speech(tmp_path / "speech", tmp_path / "data")
    speakers = [value for name in ("train", "dev", "test")
                for value in table(tmp_path / "data" / f"{name}.clean" / "utt2spk").values()]
    assert sorted(set(speakers)) == ["Anna", "Anna_Maria", "Bob", "Carl"] and len(speakers) == 8


def test_data_directories_below_the_speech_are_not_read_again(tmp_path, monkeypatch):
    for n in range(12):
        put(tmp_path / f"speaker{n}" / "a.wav", rir(f"{n}", 1600), fs_hz=48000)  # converted audio is written to data
    monkeypatch.chdir(tmp_path)
    first, again = ([(path / "wav.scp").read_text() for path in prepare_speech(Path(), Path("data"))]
                    for _ in range(2))
    assert again == first and sum(text.count("\n") for text in first) == 12
    with pytest.raises(ValueError, match="is the folder of the speech corpus"):
        prepare_speech(tmp_path, Path())


@pytest.mark.parametrize("below", [".", "LibriSpeech"])
def test_librispeech_matches_the_stock_recipe(tmp_path, below):
    source = tmp_path / "corpus"
    put_librispeech(source / below, SETS)
    train, dev, test = prepare_speech(source, tmp_path / "data", **ROLES)
    assert [path.name for path in (train, dev, test)] == ["train.clean", "dev.clean", "test.clean"]
    assert lines(train / "utt2spk") == ["100-1-0000 100-1", "19-198-0000 19-198", "19-198-0001 19-198",
                                        "19-227-0000 19-227"]
    assert lines(train / "spk2utt") == ["100-1 100-1-0000", "19-198 19-198-0000 19-198-0001", "19-227 19-227-0000"]
    assert lines(train / "spk2gender") == ["100-1 m", "19-198 f", "19-227 f"]
    assert lines(train / "text")[1] == "19-198-0000 SOME WORDS"
    assert lines(dev / "wav.scp")[1] == (
        f"1272-128104-0001 flac -c -d -s {source / below / 'dev-clean/1272/128104/1272-128104-0001.flac'} |")
    assert lines(dev / "utt2dur") == ["1272-128104-0000 0.1", "1272-128104-0001 0.1000625"]
    assert lines(dev / "reco2dur") == lines(dev / "utt2dur")
    assert lines(test / "utt2spk") == ["61-70968-0000 61-70968"]


@pytest.mark.skipif("KALDI_ROOT" not in os.environ, reason="needs KALDI_ROOT")
def test_stock_kaldi_accepts_the_directories(tmp_path):
    put_librispeech(tmp_path / "corpus", SETS)
    stock = Path(os.environ["KALDI_ROOT"]) / "egs" / "wsj" / "s5"
    for path in prepare_speech(tmp_path / "corpus", tmp_path / "data", **ROLES):
        subprocess.run(["utils/validate_data_dir.sh", "--no-feats", path], cwd=stock, check=True,
                       env=dict(os.environ, LC_ALL="C", PATH=f"{stock / 'utils'}:{os.environ['PATH']}"))


def test_speakers_txt_with_bars_and_comments_is_read(tmp_path):
    path = put_text(tmp_path / "SPEAKERS.TXT", "; ID | SEX\n60   | M | train-clean-100  | 20.18 | |CBW|Simon\n\n")
    assert read_genders(path) == {"60": "m"}


def test_spk2gender_needs_every_gender(tmp_path):
    put_librispeech(tmp_path / "corpus", SETS)
    put_text(tmp_path / "corpus" / "SPEAKERS.TXT", "19 | F | train-clean-100 | 1 | x\n")
    train, _, _ = prepare_speech(tmp_path / "corpus", tmp_path / "data", **ROLES)
    assert not (train / "spk2gender").exists() and (train / "utt2spk").exists()


@pytest.mark.parametrize("kind, has", [("sets", "dev, test, train"), ("no sets", "no sets"), ("folders", "a, b, c"),
                                       ("kaldi", "no sets"), ("one set", "dev-clean")])
def test_chosen_sets_that_are_not_there_are_refused(tmp_path, kind, has):
    source = tmp_path / "speech"
    if kind == "one set":
        source = put_librispeech(source, {"dev-clean": SETS["dev-clean"]}) / "dev-clean"
    elif kind == "kaldi":
        put_kaldi_dir(source, ["a", "b", "c"])
    elif kind == "folders":
        for voice in "abc":
            put(source / voice / "0.flac", rir(voice, 1600))
    else:
        rows = [f"{part}.flac,{part},{part},HI,{part}" for part in ("train", "dev", "test")]
        put_manifest(source, rows, "file,utt_id,speaker,transcript," + ("set" if kind == "sets" else "notes"))
    remedy = "leave --train-sets out" if has == "no sets" else "choose with --train-sets"
    with pytest.raises(ValueError, match=rf"train set 'mine' is not in it \(it has {has}\): {remedy}"):
        prepare_speech(source, tmp_path / "data", train_sets=("mine",), dev_sets=("dev-clean",))


def test_single_set_is_split_by_voice(tmp_path):
    readers = {str(reader): {"1": 2, "2": 1} for reader in range(10, 20)}
    put_librispeech(tmp_path / "corpus", {"dev-clean": readers})
    dirs = prepare_speech(tmp_path / "corpus" / "dev-clean", tmp_path / "data")
    readers = [{line.split("-")[0] for line in lines(path / "utt2spk")} for path in dirs]
    assert sum(map(len, readers)) == 10 and len(set.union(*readers)) == 10
    assert [len(each) for each in readers] == [7, 2, 1]


def test_manifest_is_split_by_voice(tmp_path):
    counts = {"a": 8, "b": 8, "c": 8, "d": 8, "e": 4, "f": 2, "g": 2}
    put_manifest(tmp_path / "speech", rows_of_voices(counts))
    dirs = prepare_speech(tmp_path / "speech", tmp_path / "data", train_sets=("train-clean-100",),
                          dev_sets=("dev-clean",), test_sets=("test-clean",))
    voices = [set(table(path / "utt2spk").values()) for path in dirs]
    assert len(set.union(*voices)) == sum(map(len, voices)) == 7
    assert len(lines(dirs[0] / "text")) == pytest.approx(0.7 * 40, abs=4)
    assert not (dirs[0] / "spk2gender").exists()


def test_copies_of_an_utterance_have_one_voice():
    utt2spk = {f"{prefix}{speaker}-{n}": f"{prefix}{speaker}" for speaker in "abc" for n in range(2)
               for prefix in ("", "sp0.9-", "sp1.1-")}
    uniq = {utt: utt.removeprefix("sp0.9-").removeprefix("sp1.1-") for utt in utt2spk if utt.startswith("sp")}
    voices = KaldiDir(Path(), dict(utt2spk=utt2spk, utt2uniq=uniq)).voices()
    assert voices == {utt: utt.split("-")[-2] for utt in utt2spk}
    assert set(KaldiDir(Path(), dict(utt2spk=utt2spk)).voices().values()) == set(utt2spk.values())


def test_voices_are_split_in_proportion():
    roles = split_voices({"big": 100, "small": 1, "tiny": 1})
    assert roles["big"] == "train" and {roles["small"], roles["tiny"]} == {"dev", "test"}
    assert split_voices(dict.fromkeys("cab", 5)) == split_voices(dict.fromkeys("abc", 5))
    with pytest.raises(ValueError, match=r"2 speakers \(a, b\) cannot be split into train, dev, test"):
        split_voices({"a": 5, "b": 5})


def test_manifest_with_sets_and_genders(tmp_path):
    rows = [f"{name}.flac,{name},{name},HI,{gender},{part}" for name, gender, part in
            (("a", "Male", "training"), ("b", "f", "dev"), ("c", "F", "test"))]
    put_manifest(tmp_path / "speech", rows, "file,utt_id,speaker,transcript,gender,set")
    manifest = tmp_path / "speech" / "manifest.csv"
    train, dev, _ = prepare_speech(manifest, tmp_path / "data", dev_sets=("dev-clean",))
    assert lines(train / "spk2gender") == ["a m"] and lines(dev / "utt2spk") == ["b-b b"]


@pytest.mark.parametrize("row, message", [
    ("b/../a.flac,b2,b,HI,f", r"file='b/\.\./a\.flac' must be listed once and is also in .*manifest\.csv:2"),
    ("c.flac,c,a,HI,F", r"gender='F' of speaker 'a' contradicts 'm' in .*manifest\.csv:2")])
def test_manifest_that_contradicts_itself_is_refused(tmp_path, row, message):
    put(tmp_path / "speech/b/x.flac")
    rows = ["a.flac,a,a,HI,male", "b.flac,b,b,HI,", "d.flac,d,a,HI,", row]
    source = put_manifest(tmp_path / "speech", rows, "file,utt_id,speaker,transcript,gender")
    with pytest.raises(ValueError, match=rf"manifest\.csv:5: {message}: correct the row"):
        prepare_speech(source, tmp_path / "data")


@pytest.mark.parametrize("ending", [",", ", ", ""])
def test_manifest_row_without_a_set_is_refused_where_others_have_one(tmp_path, ending):
    rows = [f"{part}.flac,{part},{part},HI,{part}" for part in ("train", "dev", "test")]
    source = put_manifest(tmp_path / "speech", [*rows, f"d.flac,d,d,HI{ending}"], "file,utt_id,speaker,transcript,set")
    with pytest.raises(ValueError, match=r"manifest\.csv:5: set='' must be a name, as in other rows: fill it in"):
        prepare_speech(source, tmp_path / "data")


def test_utterances_sort_like_their_speakers(tmp_path):
    # '+' sorts before the '-' that joins speaker and utterance: either of them in a speaker's name breaks Kaldi's order
    rows = ["1.flac,x,a,HI", "2.flac,x,a+b,HI", "3.flac,a-z,a-c,HI", "4.flac,d-1,d,HI", "5.flac,e-1,e,HI"]
    put_manifest(tmp_path / "speech", rows)
    dirs = prepare_speech(tmp_path / "speech", tmp_path / "data")
    merged = {utt: spk for path in dirs for utt, spk in table(path / "utt2spk").items()}
    assert merged == {"a-x": "a", "a_b-x": "a_b", "a_c-a-z": "a_c", "d-1": "d", "e-1": "e"}


def test_audio_that_kaldi_cannot_read_is_converted(tmp_path, caplog):
    caplog.set_level("INFO")
    speech = put_manifest(tmp_path / "my speech", rows_of_voices({"a": 3, "b": 1, "c": 1}))
    put(speech / "a" / "0.flac", rir("24", 1600), subtype="PCM_24")
    put(speech / "a" / "1.flac", rir("44", 4410), fs_hz=44100)
    train, _, _ = prepare_speech(speech, tmp_path / "data")
    entries, durations = table(train / "wav.scp"), table(train / "utt2dur")
    for utt in ("a-0", "a-1"):
        made = train / "audio" / f"{utt}.flac"
        assert str(made) in entries[utt]
        assert soundfile.info(made).subtype == "PCM_16" and soundfile.info(made).samplerate == 16000
    assert entries["a-2"] == f"flac -c -d -s '{tmp_path}/my speech/a/2.flac' |"  # a shell reads it
    assert durations == {"a-0": "0.1", "a-1": "0.1", "a-2": "0.1"}
    assert "2 converted to 16000 Hz FLAC" in caplog.text and "full scale" not in caplog.text
    put(speech / "a" / "1.flac", rir("44", 4410)).unlink()
    put(speech / "a" / "1.wav", 4.0 * rir("44", 4410) / abs(rir("44", 4410)).max(), subtype="FLOAT")
    (speech / "manifest.csv").write_text((speech / "manifest.csv").read_text().replace("1.flac", "1.wav", 1))
    train, _, _ = prepare_speech(speech, tmp_path / "data")
    assert "1 files exceed full scale and were reduced to it, by up to 12.0 dB (a-1)" in caplog.text


def test_copy_that_plays_the_converted_audio_of_the_original_is_made_anew(tmp_path, monkeypatch, caplog):
    caplog.set_level("INFO")
    speech = put_manifest(tmp_path / "speech", rows_of_voices({"a": 3, "b": 1, "c": 1}))
    put(speech / "a" / "0.flac", rir("24", 1600), subtype="PCM_24")
    monkeypatch.chdir(tmp_path)
    prepare_speech(speech, "data")
    for path in (Path("data"), tmp_path / "data"):
        caplog.clear()
        prepare_speech(speech, path)
        assert caplog.text.count("up to date") == 3
    shutil.copytree("data", "copy")
    with pytest.raises(ValueError, match=r"copy/train\.clean: its wav\.scp names audio in .*/data/train\.clean"):
        digest(Path("copy/train.clean"))
    train, _, _ = prepare_speech(speech, "copy")
    assert str(tmp_path / "copy/train.clean/audio/a-0.flac") in table(train / "wav.scp")["a-0"]


@pytest.mark.skipif(not shutil.which("flac"), reason="needs flac")
def test_entries_work_in_a_shell(tmp_path):
    put_manifest(tmp_path / "it's $HOME (my) speech", rows_of_voices({"a": 3, "b": 1, "c": 1}))
    train, _, _ = prepare_speech(tmp_path / "it's $HOME (my) speech", tmp_path / "data")
    command = table(train / "wav.scp")["a-1"].removesuffix("|")
    wav = subprocess.run(command, shell=True, capture_output=True, check=True).stdout
    assert wav.startswith(b"RIFF") and len(wav) > 3200


def test_larger_limit_keeps_the_smaller_choice(tmp_path):
    put_manifest(tmp_path / "speech", rows_of_voices({"a": 9, "b": 9, "c": 3, "d": 3}))
    few, more = ({line for path in prepare_speech(tmp_path / "speech", tmp_path / f"data{limit}", limit=limit)
                  for line in lines(path / "text")} for limit in (2, 4))
    assert len(few) == 6 and few < more
    with pytest.raises(ValueError, match="limit=0 utterances must be at least 1"):
        prepare_speech(tmp_path / "speech", tmp_path / "data", limit=0)


def test_unchanged_speech_is_not_remade(tmp_path):
    root = put_librispeech(tmp_path / "corpus", SETS)

    def made():
        return [(path / "text").stat().st_mtime_ns for path in prepare_speech(root, tmp_path / "data", **ROLES)]

    first = made()
    put_text(tmp_path / "corpus" / "notes.txt", "nothing that matters")
    assert made() == first
    put(root / "dev-clean" / "1272" / "128104" / "1272-128104-0001.flac", rir("other", 1700))
    train, dev, test = made()
    assert (train, test) == (first[0], first[2]) and dev != first[1]
    assert table(tmp_path / "data" / "dev.clean" / "utt2dur")["1272-128104-0001"] == "0.10625"


def test_speech_by_another_path_is_not_remade(tmp_path, monkeypatch):
    put_manifest(tmp_path / "speech", rows_of_voices({"a": 1, "b": 1, "c": 1}))
    for voice in "def":
        put_kaldi_dir(tmp_path / "kaldi" / f"{dict(d='train', e='dev', f='test')[voice]}", [voice])
    monkeypatch.chdir(tmp_path)
    for corpus in ("speech", "kaldi"):
        made = set()
        for path in (corpus, f"../{tmp_path.name}/{corpus}", tmp_path / corpus):
            train, _, _ = prepare_speech(path, tmp_path / f"data.{corpus}")
            made.add((train / "wav.scp").stat().st_mtime_ns)
        assert len(made) == 1


def test_speech_is_found_where_a_link_leads_now(tmp_path):
    put_manifest(tmp_path / "disk1", rows_of_voices({"a": 1, "b": 1, "c": 1}))
    put_text(tmp_path / "speech/manifest.csv", (tmp_path / "disk1/manifest.csv").read_text())
    for disk in ("disk1", "disk2"):
        if disk == "disk2":
            (tmp_path / "disk1").rename(tmp_path / "disk2")
        for voice in "abc":
            link = tmp_path / "speech" / voice
            link.unlink(missing_ok=True)
            link.symlink_to(tmp_path / disk / voice)
        for made in prepare_speech(tmp_path / "speech", tmp_path / "data"):
            digest(made)


def test_speech_beside_the_files_of_a_step_counts(tmp_path):
    put_manifest(tmp_path / "speech", rows_of_voices({"a": 3, "b": 1, "c": 1}))
    train, _, _ = prepare_speech(tmp_path / "speech", tmp_path / "data")
    export("nemo", train, tmp_path / "set")

    def durations():
        made = prepare_speech(tmp_path / "set", tmp_path / "again")
        return [duration for path in made for name, duration in table(path / "utt2dur").items() if name == "b-added"]

    for n, voice in enumerate("bcd"):
        put(tmp_path / "set" / voice / "added.wav", rir(f"{n}", 1600))
    assert durations() == ["0.1"]
    put(tmp_path / "set/b/added.wav", rir("other", 3200))
    assert durations() == ["0.2"]


def test_jobs_do_not_change_the_bytes(tmp_path):
    put_librispeech(tmp_path / "corpus", SETS)
    one_job, two_jobs = (prepare_speech(tmp_path / "corpus", tmp_path / f"data{nj}", nj=nj, **ROLES) for nj in (1, 2))
    for a, b in zip(one_job, two_jobs, strict=True):
        assert {path.name: path.read_bytes() for path in a.glob("[!.]*")} == {
            path.name: path.read_bytes() for path in b.glob("[!.]*")}


def put_kaldi_dir(path, speakers, segments=False):
    utts = {f"{spk}-{n}": spk for spk in speakers for n in range(2)}
    put_text(path / "wav.scp", "".join(f"{key} /x/{key}.wav\n" for key in (speakers if segments else utts)))
    put_text(path / "text", "".join(f"{utt} HI\n" for utt in utts))
    put_text(path / "utt2spk", "".join(f"{utt} {spk}\n" for utt, spk in utts.items()))
    if segments:
        put_text(path / "segments", "".join(f"{utt} {spk} {n % 2} {n % 2 + 1}\n"
                                            for n, (utt, spk) in enumerate(utts.items())))
    return path


@pytest.mark.parametrize("segments", [False, True])
def test_kaldi_directory_is_split_by_voice(tmp_path, segments):
    speakers = ["14-208", "14-212", "20-1", "25-1", "31-1"]
    put_kaldi_dir(tmp_path / "kaldi", speakers, segments)
    dirs = prepare_speech(tmp_path / "kaldi", tmp_path / "data")
    parts = [table(path / "utt2spk") for path in dirs]
    assert sorted(utt for part in parts for utt in part) == [f"{spk}-{n}" for spk in speakers for n in (0, 1)]
    chapters = [part for part in parts if "14-208" in part.values()]
    assert len(chapters) == 1 and "14-212" in chapters[0].values()  # one reader, one role
    for path, part in zip(dirs, parts, strict=True):
        assert set(table(path / "wav.scp")) == (set(part.values()) if segments else set(part))
        assert (path / "segments").exists() == segments and not (path / "spk2gender").exists()


def test_kaldi_directory_without_transcripts_is_read_without(tmp_path, caplog):
    (put_kaldi_dir(tmp_path / "kaldi", ["a", "b", "c"]) / "text").unlink()
    for directory in prepare_speech(tmp_path / "kaldi", tmp_path / "data"):
        assert len(lines(directory / "wav.scp")) == 2 and not (directory / "text").exists()
    assert "kaldi: no text: no transcripts are written" in caplog.text


def test_several_kaldi_directories_are_sets(tmp_path):
    for name, speakers in (("train_a", ["a"]), ("train_b", ["b"]), ("dev", ["c"]), ("test", ["d"])):
        put_kaldi_dir(tmp_path / "data" / name, speakers)
    train, _, test = prepare_speech(tmp_path / "data", tmp_path / "out")
    assert set(table(train / "utt2spk").values()) == {"a", "b"} and set(table(test / "utt2spk").values()) == {"d"}


def test_shared_recordings(shared_data, tmp_path):
    dirs = prepare_speech(shared_data / "speech", tmp_path / "data")
    counts = [(len(lines(path / "utt2spk")), len(lines(path / "spk2utt"))) for path in dirs]
    assert counts == [(60, 6), (15, 2), (12, 2)]
    for path in dirs:
        for utt, entry in table(path / "wav.scp").items():
            info = soundfile.info(entry.split()[-2])
            assert float(table(path / "utt2dur")[utt]) == pytest.approx(info.frames / 16000, abs=1e-9)


def test_mismatch_of_transcripts_and_audio_is_refused(tmp_path):
    root = put_librispeech(tmp_path / "corpus", SETS)
    chapter = root / "dev-clean" / "1272" / "128104"
    trans = chapter / "1272-128104.trans.txt"

    def prepare(**options):
        return prepare_speech(root, tmp_path / "data", **ROLES, **options)

    text = trans.read_text()
    for changed, message in (
            (text.replace("0001 SOME WORDS", "0001"), r"trans\.txt:2: utterance 1272-128104-0001 has no words"),
            (text.replace("1272-128104-0001", "9-9-1"), r"trans\.txt:2: utterance '9-9-1' must start with"),
            (text + "1272-128104-0002 X\n", r"trans\.txt:3: no audio .*1272-128104-0002\.flac"),
            (text + text, r"trans\.txt:3: utterance 1272-128104-0000 occurs twice"),
            ("", r"0000\.flac: no transcript in .*trans\.txt \(2 such\)")):
        trans.write_text(changed)
        with pytest.raises(ValueError, match=message) as caught:
            prepare()
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "data" / "dev.clean").exists()
    trans.write_text(text)
    flac = chapter / "1272-128104-0001.flac"
    flac.write_bytes(flac.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"0001\.flac: broken audio .*\(named by .*trans\.txt:2\)"):
        prepare()
    put(flac, rir("8k"), fs_hz=8000)
    with pytest.raises(ValueError, match=r"0001\.flac: sample rate 8000 Hz must be at least 16000 Hz"):
        prepare()
    put(flac, rir("stereo", channels=2))
    with pytest.raises(ValueError, match=r"0001\.flac: channel 2 of 2: count from 0"):
        prepare(channel=2)


def test_missing_or_shared_sets_are_refused(tmp_path):
    root = put_librispeech(tmp_path / "corpus", SETS)
    with pytest.raises(ValueError, match=r"train set 'train-clean-999' is not in it \(it has dev-.*--train-"):
        prepare_speech(root, tmp_path / "data", **ROLES | dict(train_sets=("train-clean-999",)))
    with pytest.raises(ValueError, match=r"test set '\(none named\)' is not in it"):
        prepare_speech(root, tmp_path / "data", **ROLES | dict(test_sets=()))
    with pytest.raises(ValueError, match="set 'dev-clean' is named 2 times"):
        prepare_speech(root, tmp_path / "data", **ROLES | dict(test_sets=("dev-clean",)))


@pytest.mark.parametrize("row, message", [
    ("a/0.flac,a-0,a,", r"manifest\.csv:2: transcript='' of a/0\.flac must hold the words that are spoken: "
     "correct the row"),
    ("a/9.flac,a-0,a,HI", r"manifest\.csv:3: utterance a-0 is also in .*manifest\.csv:2: ids must be unique"),
    ("a/9.flac,a-9,a,HI", r"9\.flac: no such audio file: check the path \(named by .*manifest\.csv:2\)")])
def test_bad_manifest_row_is_refused(tmp_path, row, message):
    source = put_manifest(tmp_path / "speech", rows_of_voices({"a": 9, "b": 2, "c": 2}))
    head, *rest = lines(source / "manifest.csv")
    put_text(source / "manifest.csv", "\n".join([head, row, *rest]) + "\n")
    with pytest.raises(ValueError, match=message):
        prepare_speech(source, tmp_path / "data")


def test_folders_without_transcripts_are_speakers(tmp_path, caplog):
    for name in ("wavs/p1/a.wav", "wavs/p1/b.wav", "wavs/p2/c 1.wav", "wavs/p3/sub/a.wav"):
        put(tmp_path / "speech" / name, rir(name, 1600))
    made = prepare_speech(tmp_path / "speech", tmp_path / "data")
    utt2spk = {key: value for directory in made for key, value in table(directory / "utt2spk").items()}
    assert utt2spk == {"p1-a": "p1", "p1-b": "p1", "p2-c-1": "p2", "p3-sub-a": "p3"}
    assert not any((directory / "text").exists() for directory in made)
    assert "no transcripts: each of 4 audio files is an utterance" in caplog.text
    assert "no folders" not in caplog.text
    for directory in made:
        validate_data_dir(directory)


def test_files_in_no_folder_have_speakers_of_their_own(tmp_path, caplog):
    for n in range(6):
        put(tmp_path / "speech" / f"file{n}.wav", rir(str(n), 1600))
    made = prepare_speech(tmp_path / "speech", tmp_path / "data")
    utt2spk = {key: value for directory in made for key, value in table(directory / "utt2spk").items()}
    assert utt2spk == {f"file{n}": f"file{n}" for n in range(6)}
    assert "no folders of speakers for 6 of 6 files: each of them counts as a speaker of its own" in caplog.text


def test_folders_named_like_sets_are_sets(tmp_path, caplog):
    for name in ("train/p1/a.wav", "train/p2/a.wav", "dev/p3/a.wav", "test/p4/a.wav"):
        put(tmp_path / "speech" / name, rir(name, 1600))
    made = prepare_speech(tmp_path / "speech", tmp_path / "data")
    assert [sorted(table(directory / "utt2spk")) for directory in made] == [
        ["train-p1-a", "train-p2-a"], ["dev-p3-a"], ["test-p4-a"]]
    assert "no folders" not in caplog.text


def test_augmentation_takes_speech_without_transcripts(tmp_path):
    for name in ("p1/a.wav", "p2/a.wav", "p3/a.wav"):
        put(tmp_path / "speech" / name, rir(name, 1600))
    put(tmp_path / "rirs" / "a.wav")
    read_measured(tmp_path / "rirs", tmp_path / "measured")
    characterise(tmp_path / "measured", tmp_path / "real")
    made = prepare_speech(tmp_path / "speech", tmp_path / "data")
    augment(made[0], tmp_path / "real", tmp_path / "rvb")
    assert not (tmp_path / "rvb" / "text").exists() and len(lines(tmp_path / "rvb" / "wav.scp")) == 1
    validate_data_dir(tmp_path / "rvb")


@pytest.mark.parametrize("channel", [0, 1])
def test_chosen_channel_of_stereo_is_used_and_named(tmp_path, caplog, channel):
    caplog.set_level("INFO")
    stereo = np.column_stack([rir("left", 1600), rir("right", 1600)])
    for voice in "abc":
        put(tmp_path / "speech" / voice / "x.wav", stereo)
    made = prepare_speech(tmp_path / "speech", tmp_path / "data", channel=channel)
    samples, _ = soundfile.read(made[0] / "audio" / "a-x.flac")
    np.testing.assert_allclose(samples, stereo[:, channel], atol=2e-4)
    assert f"1 files have several channels: channel {channel} is used, counted from 0 (choose with --channel)" \
        in caplog.text


def test_channel_of_a_kaldi_directory_is_chosen_in_its_table(tmp_path):
    put_kaldi_dir(tmp_path / "kaldi", ["a", "b", "c"])
    with pytest.raises(ValueError, match=r"kaldi: channel=1 must be 0, .* choose the channel in wav\.scp"):
        prepare_speech(tmp_path / "kaldi", tmp_path / "data", channel=1)


def test_source_without_speech_is_refused(tmp_path):
    with pytest.raises(ValueError, match="absent: no such file or directory: check the path of the speech corpus"):
        prepare_speech(tmp_path / "absent", tmp_path / "data")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty: no speech corpus: expected LibriSpeech"):
        prepare_speech(tmp_path / "empty", tmp_path / "data")
    put_text(tmp_path / "no text" / "manifest.csv", "file,speaker\na.wav,a\n")
    with pytest.raises(ValueError, match="columns file,speaker must hold 'transcript'"):
        prepare_speech(tmp_path / "no text", tmp_path / "data")


@pytest.mark.parametrize("name, text, message", [
    ("text", "", "text: missing or empty: complete the data directory"),
    ("text", "a-0 HI\n", "text: utterance a-1 of utt2spk is not in it"),
    ("wav.scp", "a-0 x.wav\n", r"wav\.scp: utterance a-1 of utt2spk is not in it"),
    ("segments", "a-0 r 0 1\n", r"wav\.scp: recording r of segments is not in it"),
    ("utt2spk", "a-0 a\na-0 a\n", "utt2spk:2: a-0 occurs twice"),
    ("utt2spk", "a-0\n", "utt2spk:1: 'a-0' has no value"),
    ("utt2spk", "a-0 z\na-1 y\nb-0 x\nb-1 w\nc-0 c\nc-1 c\n", "sorts apart from its speaker: utterance ids must")])
def test_bad_kaldi_directory_is_refused(tmp_path, name, text, message):
    put_kaldi_dir(tmp_path / "kaldi", ["a", "b", "c"])
    put_text(tmp_path / "kaldi" / name, text)
    with pytest.raises(ValueError, match=message):
        prepare_speech(tmp_path / "kaldi", tmp_path / "data")
