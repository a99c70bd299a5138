"""Data directories: the forms of `wav.scp` and `segments`, and refused input."""

import os
import pickle
import shutil
import subprocess
import tracemalloc
from pathlib import Path

import kaldiio
import numpy as np
import pytest
import soundfile
from datadirs import FS, LENGTHS, burst, speech_dir
from hypothesis import given
from hypothesis import strategies as st

from roomeq.core.audio import write_flac, write_wav
from roomeq.kaldi import validate_data_dir
from roomeq.kaldi.datadir import read_data_dir, read_utterance
from roomeq.kaldi.wavscp import Entry, flac_entry, parse_entry, read_entry
from roomeq.kaldi.write import OutUtterance, format_seconds, write_data_dir


def edit(path, change):
    """Replace the lines of a file by `change(lines)`."""
    path.write_text("".join(f"{line}\n" for line in change(path.read_text().splitlines())))


def test_segments_that_kaldi_leaves_out_are_said(tmp_path, caplog):
    path = speech_dir(tmp_path / "in")
    (path / "utt2dur").unlink()
    names = sorted(LENGTHS, key=str.encode)
    for end_s, said in (("0.12", False), ("0.11", True)):
        (path / "segments").write_text("".join(f"{name} {name} 0.01 {end_s}\n" for name in names))
        validate_data_dir(path)
        assert ("not longer than" in caplog.text) is said
    assert f"{len(names)} segments are not longer than 0.1 s" in caplog.text and "Kaldi leaves them out" in caplog.text


# --- wav.scp

@pytest.mark.parametrize("text, entry", [
    ("a.wav", Entry("file", "a.wav")),
    ("dir with blank/a.wav", Entry("file", "dir with blank/a.wav")),
    ("raw.ark:1234", Entry("ark", "raw.ark", 1234)),
    ("flac -c -d -s a.flac |", Entry("file", "a.flac")),
    ("flac -cds a.flac|", Entry("file", "a.flac")),
    ("/usr/bin/flac  --stdout --decode --silent a.flac |", Entry("file", "a.flac")),
    ("flac -d -c -s -- a.flac |", Entry("file", "a.flac")),
    ("flac -c -d -s 'it'\"'\"'s a $(touch x).flac' |", Entry("file", "it's a $(touch x).flac")),
    ('flac -c -d -s "two words.flac" |', Entry("file", "two words.flac")),
    ("flac -c -d -s two\\ words.flac |", Entry("file", "two words.flac")),
    ("flac -c -d -s $(touch x).flac |", Entry("pipe", "flac -c -d -s $(touch x).flac")),
    ("flac -c -d -s `touch x`.flac |", Entry("pipe", "flac -c -d -s `touch x`.flac")),
    ('flac -c -d -s "$(touch x).flac" |', Entry("pipe", 'flac -c -d -s "$(touch x).flac"')),
    ("flac -c -d -s a.flac; touch x |", Entry("pipe", "flac -c -d -s a.flac; touch x")),
    ("flac -c -d -s a.flac | sox - -t wav - |", Entry("pipe", "flac -c -d -s a.flac | sox - -t wav -")),
    ("flac -c -d -s *.flac |", Entry("pipe", "flac -c -d -s *.flac")),
    ("flac -c -d -s a.flac b.flac |", Entry("pipe", "flac -c -d -s a.flac b.flac")),
    ("flac -c -d -s --skip=100 a.flac |", Entry("pipe", "flac -c -d -s --skip=100 a.flac")),
    ("flac -s a.flac |", Entry("pipe", "flac -s a.flac")),
    ("sph2pipe -f wav -p a.sph |", Entry("pipe", "sph2pipe -f wav -p a.sph")),
    ("touch x; flac -c -d -s a.flac |", Entry("pipe", "touch x; flac -c -d -s a.flac")),
])
def test_entry_is_parsed_as_file_archive_or_pipe(text, entry):
    assert parse_entry(text) == entry


def test_command_that_fails_ahead_of_another_is_refused(tmp_path):
    write_wav(tmp_path / "a.wav", burst(np.random.default_rng(0), 8000))
    path = tmp_path / "a.wav"
    assert len(read_entry(parse_entry(f"yes | cat {path} |"), pipes=True)) == 8000  # which reads nothing of it
    with pytest.raises(ValueError, match="failed with status 3"):
        read_entry(parse_entry(f"(cat {path}; exit 3) | cat |"), pipes=True)


@pytest.mark.parametrize("text", ["", "-", "|tee x", "a.ark:12[0:3]"])
def test_entry_that_names_no_audio_is_refused(text):
    with pytest.raises(ValueError, match="names no audio|selects a range"):
        parse_entry(text)


paths = st.text(st.characters(codec="utf-8", exclude_characters="\n\r\0"), min_size=1).filter(lambda s: s.strip() == s)


@given(paths)
def test_flac_entry_is_parsed_back_to_its_path(path):
    entry = parse_entry(flac_entry(path))
    assert entry == Entry("file", "./" + path if path.startswith("-") else path)


@pytest.mark.skipif(not shutil.which("flac"), reason="needs flac")
@pytest.mark.parametrize("name", ["plain", "two words", "it's", "$(touch x)", "`touch x`", '"', "a;touch x", "-d", "|"])
def test_shell_and_reader_open_the_same_file(tmp_path, monkeypatch, name):
    """Kaldi passes the entry to a shell, which must see the same file name and run nothing else."""
    monkeypatch.chdir(tmp_path)
    write_flac(Path(f"./{name}.flac"), burst(np.random.default_rng(0), 1600))
    entry = flac_entry(f"{name}.flac")
    shell = subprocess.run(entry.rstrip("|"), shell=True, capture_output=True, check=True).stdout
    assert np.array_equal(np.frombuffer(shell[-3200:], "<i2"), np.rint(read_entry(parse_entry(entry)) * 32768))
    assert not Path("x").exists()


@pytest.mark.parametrize("path, message", [("a\nb.flac", "line break"), ("a\udcff.flac", "UTF-8")])
def test_path_that_wav_scp_cannot_hold_is_refused(path, message):
    with pytest.raises(ValueError, match=message):
        flac_entry(path)


@pytest.mark.parametrize("how", [None, "soundfile"])
def test_archives_are_read_at_their_offset(tmp_path, how):
    rng = np.random.default_rng(0)
    x = {key: np.rint(burst(rng, n) * 32768).astype(np.int16) for key, n in (("a", 1000), ("b", 2000), ("c", 3000))}
    kaldiio.save_ark(str(tmp_path / "wav.ark"), {key: (FS, value) for key, value in x.items()},
                     scp=str(tmp_path / "wav.scp"), write_function=how)
    for line in (tmp_path / "wav.scp").read_text().splitlines():
        key, text = line.split(maxsplit=1)
        entry = parse_entry(text)
        assert entry.kind == "ark"
        assert np.array_equal(read_entry(entry) * 32768, x[key])
        assert np.array_equal(read_entry(entry, 0.01, 0.05) * 32768, x[key][160:800])


@pytest.mark.parametrize("subtype", ["ULAW", "MS_ADPCM", "PCM_24", "PCM_32", "FLOAT"])
def test_wav_of_any_encoding_in_an_archive_is_that_of_the_file(tmp_path, subtype):
    soundfile.write(tmp_path / "x.wav", burst(np.random.default_rng(0), 1000), FS, subtype=subtype)
    wav = (tmp_path / "x.wav").read_bytes()
    entry = ark(tmp_path, wav + b"b " + wav)  # another utterance follows
    assert np.array_equal(read_entry(entry), soundfile.read(tmp_path / "x.wav", dtype="float32")[0])


def test_utterance_of_a_large_archive_takes_little_memory(tmp_path):
    soundfile.write(tmp_path / "x.flac", burst(np.random.default_rng(0), 1000), FS)
    entry = ark(tmp_path, (tmp_path / "x.flac").read_bytes())
    os.truncate(entry.text, 200 << 20)  # as if many followed
    tracemalloc.start()
    assert len(read_entry(entry)) == 1000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def ark(tmp_path, content):
    (tmp_path / "x.ark").write_bytes(b"key " + content)
    return Entry("ark", str(tmp_path / "x.ark"), 4)


class Bomb:
    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def wav_bytes(tmp_path, n_samples=800, channels=1, fs_hz=FS):
    x = burst(np.random.default_rng(0), n_samples * channels).reshape(-1, channels)
    soundfile.write(tmp_path / "x.wav", x, fs_hz, subtype="PCM_16")
    return (tmp_path / "x.wav").read_bytes()


@pytest.mark.parametrize("content, message", [
    (lambda path: b"PKL" + pickle.dumps(Bomb()), "pickles are not supported"),
    (lambda path: b"NPY\x01\x08abcdefgh", "arrays and pickles are not supported"),
    (lambda path: b"\0BFM \x04\x01\0\0\0\x04\x01\0\0\0abcd", "matrices"),
    (lambda path: b"", "the offset must lie within the archive.s 4 bytes"),
    (lambda path: b"AUDIO\x08\xff\xff\xff\xff\xff\xff\xff\x7fabc", "broken audio"),
    (lambda path: b"RIFFabcdefgh", "truncated"),
    (lambda path: b"RIFF\4\0\0\0abcdefgh", "broken audio"),
    (lambda path: wav_bytes(path)[:4] + b"\xff" * 4 + wav_bytes(path)[8:], "must state its length"),
    (lambda path: wav_bytes(path)[:-400], "truncated|broken"),
    (lambda path: wav_bytes(path, channels=2), "2 channels"),
    (lambda path: wav_bytes(path, fs_hz=8000), "sample rate 8000 Hz must be at least 16000 Hz"),
], ids=["pickle", "npy", "matrix", "end", "length", "short", "riff", "streamed", "truncated", "stereo", "rate"])
def test_broken_or_unsafe_archive_is_refused(tmp_path, monkeypatch, content, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        read_entry(ark(tmp_path, content(tmp_path)))
    assert not Path("unpickled").exists()


def test_commands_run_only_when_allowed(tmp_path):
    speech = speech_dir(tmp_path / "clean")
    wav = tmp_path / "clean/wav/a-1-0001.flac"
    edit(speech / "wav.scp", lambda lines: [f"a-1-0001 touch {tmp_path}/ran; cat {wav} |", *lines[1:]])
    with pytest.raises(ValueError, match=r"wav.scp:1: .*is a command other than .*only with --pipes"):
        read_data_dir(speech)
    assert validate_data_dir(speech) == 5
    assert not (tmp_path / "ran").exists()
    data = read_data_dir(speech, pipes=True)
    assert not (tmp_path / "ran").exists()
    samples = read_utterance(data, data.utterances["a-1-0001"], pipes=True)
    assert (tmp_path / "ran").exists()
    assert np.array_equal(samples, soundfile.read(wav, dtype="float32")[0])


@pytest.mark.parametrize("command, message", [("echo no; exit 3", "status 3"), ("echo oh >&2; false", "oh"),
                                              ("echo text", "cannot be read as audio"), ("true", "cannot be read")])
def test_failing_command_is_refused_with_its_reason(command, message):
    with pytest.raises(ValueError, match=message):
        read_entry(Entry("pipe", command), pipes=True)
    with pytest.raises(ValueError, match="only with --pipes"):
        read_entry(Entry("pipe", command))


@pytest.mark.parametrize("name", ["$(touch x)", "`touch x`", "a;touch${IFS}x", "'\"", "-rf", "../up", "ü"])
def test_ids_are_never_executed_or_used_as_paths(tmp_path, monkeypatch, name):
    """Use a hostile id as speaker, utterance and file name."""
    from datadirs import rir_dir

    from roomeq.augment import augment

    monkeypatch.chdir(tmp_path)
    name = name.replace(" ", "\u00b7")
    write_flac(Path("clean.flac"), burst(np.random.default_rng(0), 8000))
    write_data_dir(Path("in"), {f"{name}-1": (flac_entry("clean.flac"), 8000)},
                   [OutUtterance(f"{name}-1", name, f"{name}-1", 0, 8000, text="A")], segmented=False)
    rir_dir(Path("rirs"), n_rooms=1)
    before = sorted(Path().iterdir())
    augment("in", "rirs", "out", packing="utterance")
    assert validate_data_dir("out") == 1
    assert {path.name for path in Path().iterdir()} - {path.name for path in before} == {"out", ".out.lock"}
    assert not Path("x").exists() and not (tmp_path.parent / "up").exists()


# --- segments and reading

def test_segments_are_cut_to_the_sample(tmp_path):
    x = burst(np.random.default_rng(0), 5 * FS)
    write_flac(tmp_path / "r.flac", x)
    (tmp_path / "wav.scp").write_text(f"r {tmp_path}/r.flac\n")
    (tmp_path / "segments").write_text("s-1 r 0.00 1.2345625\ns-2 r 1.5 -1\ns-3 r 2 5.005\n")
    (tmp_path / "utt2spk").write_text("s-1 s\ns-2 s\ns-3 s\n")
    data = read_data_dir(tmp_path)
    pcm = soundfile.read(tmp_path / "r.flac", dtype="float32")[0]
    for key, start, stop in (("s-1", 0, 19753), ("s-2", 24000, 80000), ("s-3", 32000, 80000)):
        assert np.array_equal(read_utterance(data, data.utterances[key]), pcm[start:stop])
    assert data.text is None and data.spk2gender == {}
    edit(tmp_path / "segments", lambda lines: [*lines[:2], "s-3 r 2 5.02"])
    data = read_data_dir(tmp_path)
    with pytest.raises(ValueError, match="utterance s-3: .*segment from 2 s to 5.02 s must lie within .* 5 s"):
        read_utterance(data, data.utterances["s-3"])


def test_other_sample_rates_are_resampled_or_refused(tmp_path):
    t = np.arange(48000) / 48000
    write_wav(tmp_path / "high.wav", 0.5 * np.sin(2 * np.pi * 440 * t), 48000)
    samples = read_entry(Entry("file", str(tmp_path / "high.wav")), 0.25, 0.75)
    assert len(samples) == 8000
    expected = 0.5 * np.sin(2 * np.pi * 440 * (np.arange(8000) / FS + 0.25))
    assert np.max(np.abs(samples - expected)[200:-200]) < 1e-3
    write_wav(tmp_path / "low.wav", t[:8000], 8000)
    with pytest.raises(ValueError, match="low.wav: sample rate 8000 Hz"):
        read_entry(Entry("file", str(tmp_path / "low.wav")))


def test_written_directory_is_read_back(tmp_path):
    speech = speech_dir(tmp_path)
    data = read_data_dir(speech)
    assert list(data.utterances) == sorted(LENGTHS)
    assert data.spk2gender == dict(a="f", b="m")
    assert data.text["b-1-0002"] == "WORDS OF B-1-0002"
    assert data.utt2dur == {key: n / FS for key, n in LENGTHS.items()}
    assert (speech / "spk2utt").read_text() == "a a-1-0001 a-1-0002 a-2-0001\nb b-1-0001 b-1-0002\n"
    assert validate_data_dir(speech) == 5


@given(st.integers(0, 10**11))
def test_formatted_seconds_are_exact(n_samples):
    text = format_seconds(n_samples)
    assert int(float(text) * FS + 0.5) == n_samples
    assert "." in text and len(text.partition(".")[2]) >= 2
    if n_samples % 160 == 0:
        assert len(text.partition(".")[2]) == 2


@given(st.lists(st.tuples(st.integers(1, 400000), st.integers(0, 5000)), min_size=1, max_size=8))
def test_written_segments_are_read_back_to_the_sample(tmp_path_factory, spans):
    directory, position, utterances = tmp_path_factory.mktemp("d"), 0, []
    for n, (length, gap) in enumerate(spans):
        utterances.append(OutUtterance(f"s-{n}", "s", "r", position, length))
        position += length + gap
    write_data_dir(directory, dict(r=("r.flac", position)), utterances)
    read = read_data_dir(directory).utterances
    assert [(int(u.start_s * FS + 0.5), int(u.end_s * FS + 0.5)) for u in read.values()] == [
        (u.start, u.start + u.n_samples) for u in utterances]


def test_writing_unsorted_utterances_is_refused(tmp_path):
    for ids in (["b", "a"], ["a", "a"]):
        with pytest.raises(ValueError, match="must be sorted, each once"):
            write_data_dir(tmp_path, dict(r=("r.wav", 99)), [OutUtterance(key, "s", "r", 0, 9) for key in ids])
    with pytest.raises(ValueError, match="make the speaker id the start"):
        write_data_dir(tmp_path, dict(r=("r.wav", 99)),
                       [OutUtterance("a", "z", "r", 0, 9), OutUtterance("b", "y", "r", 0, 9)])
    with pytest.raises(ValueError, match="no utterances"):
        write_data_dir(tmp_path, {}, [])
    assert not list(tmp_path.iterdir())


# --- corruptions: roomeq finds each of them, and Kaldi finds those that it checks for

def drop_line(lines):
    return lines[:2] + lines[3:]


CORRUPTIONS = {
    "text-empty": ("text", lambda lines: [*lines[:1], "a-1-0002", *lines[2:]], r"text:2: transcript of 'a-1-0002' is"),
    "text-missing-line": ("text", drop_line, r"utt2spk:3: 'a-2-0001' is not in text"),
    "text-more": ("text", lambda lines: [*lines, "c-1 X"], r"text:6: 'c-1' is not in utt2spk"),
    "text-symbol": ("text", lambda lines: ["a-1-0001 A <s> B", *lines[1:]], "'<s>' in the transcript"),
    "text-control": ("text", lambda lines: ["a-1-0001 A\x07B", *lines[1:]], r"text:1: character '\\x07'"),
    "text-nbsp": ("text", lambda lines: ["a-1-0001 A\u00a0B", *lines[1:]], r"text:1: character '\\xa0'"),
    "text-cr": ("text", lambda lines: [f"{line}\r" for line in lines], r"text:1: line ends as on Windows"),
    "utt2spk-duplicate": ("utt2spk", lambda lines: [lines[0], *lines], "utt2spk:2: id 'a-1-0001' occurs twice"),
    "utt2spk-unsorted": ("utt2spk", lambda lines: lines[::-1], r"utt2spk:2: id 'b-1-0001' must not come after"),
    "utt2spk-speaker-order": ("utt2spk", lambda lines: ["a-1-0001 z", *lines[1:]], "speaker 'a' must not come after"),
    "utt2spk-columns": ("utt2spk", lambda lines: ["a-1-0001 a b", *lines[1:]], "'a b' of 'a-1-0001' must be one word"),
    "utt2spk-no-speaker": ("utt2spk", lambda lines: ["a-1-0001", *lines[1:]], "utt2spk:1: nothing stands after"),
    "utt2spk-blank-line": ("utt2spk", lambda lines: [*lines, ""], "utt2spk:6: '' must start with an id"),
    "spk2utt-missing-line": ("spk2utt", lambda lines: lines[:1], "utterance 'b-1-0001' of utt2spk is not in it"),
    "spk2utt-swapped": ("spk2utt", lambda lines: [lines[0] + " b-1-0001", lines[1]], "spk2utt:1: utterance 'b-1-0001'"),
    "wav-missing-line": ("wav.scp", drop_line, "'a-2-0001' is not in wav.scp"),
    "wav-unsorted": ("wav.scp", lambda lines: lines[::-1], "wav.scp:2: id 'b-1-0001' must not come after"),
    "wav-tilde": ("wav.scp", lambda lines: ["a-1-0001 ~/a.wav", *lines[1:]], "must not start with '~'"),
    "gender-value": ("spk2gender", lambda lines: ["a female", lines[1]], "'female' of 'a' must be m or f"),
    "gender-missing": ("spk2gender", lambda lines: lines[:1], "'b' is not in spk2gender"),
    "dur-zero": ("utt2dur", lambda lines: ["a-1-0001 0", *lines[1:]], "'0' of 'a-1-0001' must be a positive number"),
    "dur-missing": ("utt2dur", drop_line, "'a-2-0001' is not in utt2dur"),
    "reco-dur-nan": ("reco2dur", lambda lines: ["a-1-0001 nan", *lines[1:]], "'nan' of 'a-1-0001' must be a positive"),
    "reco-dur-missing": ("reco2dur", drop_line, "'a-2-0001' is not in reco2dur"),
    "uniq-more": ("utt2uniq", lambda lines: [*lines, "c c"], "'c' is not in utt2spk"),
    "frames-fraction": ("utt2num_frames", lambda lines: ["a-1-0001 9.5", *lines[1:]], "a positive whole number"),
}
AUDIO_CORRUPTIONS = {
    "audio-missing": (lambda path: path.unlink(), "wav.scp:1: .*no such audio file"),
    "audio-empty": (lambda path: path.write_bytes(b""), "wav.scp:1: .*audio file is empty"),
    "audio-garbage": (lambda path: path.write_bytes(b"garbage" * 99), "wav.scp:1: .*cannot be read as audio"),
}
SEGMENT_CORRUPTIONS = {
    "segment-past-end": (["s-1 r 0.00 1.00", "s-2 r 1.00 3.50"], r"segments:2: recording r: .*1 s to 3.5 s must lie"),
    "segment-backwards": (["s-1 r 0.00 1.00", "s-2 r 2.00 1.50"], "segments:2: segment from 2.00 to 1.50 must be"),
    "segment-negative": (["s-1 r -1.00 1.00", "s-2 r 1.00 1.50"], "segments:1: segment from -1.00"),
    "segment-nan": (["s-1 r nan 1.00", "s-2 r 1.00 1.50"], "segments:1: segment from nan"),
    "segment-columns": (["s-1 r 0.00", "s-2 r 1.00 1.50"], "segments:1: 'r 0.00' must be RECORDING START END"),
    "segment-minus-1": (["s-1 r 0.00 1.00", "s-2 r 1.00 -1"], "segments:2: end -1 of 's-2'"),
    "segment-recording": (["s-1 q 0.00 1.00", "s-2 r 1.00 1.50"], "segments:1: recording 'q' is not in wav.scp"),
    "segment-missing": (["s-1 r 0.00 1.00"], "utt2spk:2: 's-2' is not in segments"),
}


def complete_dir(path):
    """A directory that has also the files we do not write for it."""
    speech_dir(path)
    (path / "utt2uniq").write_text("".join(f"{key} {key}\n" for key in sorted(LENGTHS)))
    (path / "utt2num_frames").write_text("".join(f"{key} 50\n" for key in sorted(LENGTHS)))
    return path


def segmented_dir(path):
    write_flac(path / "r.flac", burst(np.random.default_rng(0), 3 * FS))
    write_data_dir(path, dict(r=(flac_entry(path / "r.flac"), 3 * FS)), [
        OutUtterance("s-1", "s", "r", 0, FS, text="A"), OutUtterance("s-2", "s", "r", FS, 2 * FS, text="B")])
    assert validate_data_dir(path) == 2
    return path


@pytest.mark.parametrize("case", CORRUPTIONS)
def test_corrupted_tables_are_found(tmp_path, case):
    name, change, message = CORRUPTIONS[case]
    complete_dir(tmp_path)
    assert validate_data_dir(tmp_path) == 5
    edit(tmp_path / name, change)
    with pytest.raises(ValueError, match=message) as caught:
        validate_data_dir(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", AUDIO_CORRUPTIONS)
def test_corrupted_audio_is_found(tmp_path, case):
    change, message = AUDIO_CORRUPTIONS[case]
    change(complete_dir(tmp_path) / "wav" / "a-1-0001.flac")
    with pytest.raises(ValueError, match=message):
        validate_data_dir(tmp_path)


@pytest.mark.parametrize("case", SEGMENT_CORRUPTIONS)
def test_corrupted_segments_are_found(tmp_path, case):
    lines, message = SEGMENT_CORRUPTIONS[case]
    edit(segmented_dir(tmp_path) / "segments", lambda old: lines)
    with pytest.raises(ValueError, match=message):
        validate_data_dir(tmp_path)


@pytest.mark.parametrize("change, message", [
    (lambda d: shutil.rmtree(d), "no such data directory"),
    (lambda d: (d / "utt2spk").unlink(), "utt2spk: no such file"),
    (lambda d: (d / "wav.scp").write_text(""), "wav.scp: file is empty"),
    (lambda d: (d / "spk2utt").unlink(), "spk2utt: no such file"),
    (lambda d: (d / "text").write_bytes(b"a-1-0001 \xff\n"), "text:1: byte 0xff is not UTF-8"),
    (lambda d: (d / "utt2spk").write_text((d / "utt2spk").read_text()[:-1]), "utt2spk:5: last line must end"),
    (lambda d: edit(d / "wav.scp", lambda lines: ["a-1-0001 |tee", *lines[1:]]), "wav.scp:1: .*names no audio"),
])
def test_broken_files_are_named(tmp_path, change, message):
    change(complete_dir(tmp_path / "d"))
    with pytest.raises(ValueError, match=message):
        validate_data_dir(tmp_path / "d")


def test_directory_without_text_is_valid_and_said_to_have_none(tmp_path, caplog):
    data = complete_dir(tmp_path / "d")
    (data / "text").unlink()
    assert validate_data_dir(data) == 5
    assert "no text: recognisers cannot be trained with it" in caplog.text


@pytest.fixture(scope="module")
def kaldi_validates(tmp_path_factory):
    """Kaldi's own validator, as a function; skipped where `KALDI_ROOT` does not say where Kaldi is."""
    root = Path(os.environ.get("KALDI_ROOT", "/nonexistent")) / "egs/wsj/s5/utils"
    if not (root / "validate_data_dir.sh").is_file():
        pytest.skip("needs Kaldi's scripts: set KALDI_ROOT")
    work = tmp_path_factory.mktemp("kaldi")
    (work / "utils").symlink_to(root)
    (work / "path.sh").write_text("export LC_ALL=C\n")

    def validates(directory):
        done = subprocess.run(["utils/validate_data_dir.sh", "--no-feats", str(directory.resolve())], cwd=work,
                              capture_output=True, text=True)
        return "Successfully validated" in done.stdout + done.stderr

    return validates


# Kaldi takes an empty transcript, and a NaN duration that we refuse; it never opens audio
LAXER_KALDI = {"text-empty", "reco-dur-nan"}


def test_kaldi_accepts_valid_directory(tmp_path, kaldi_validates):
    assert kaldi_validates(complete_dir(tmp_path / "a"))
    assert kaldi_validates(segmented_dir(tmp_path / "b"))


@pytest.mark.parametrize("case", sorted(set(CORRUPTIONS) - LAXER_KALDI))
def test_kaldi_refuses_corrupted_directory(tmp_path, kaldi_validates, case):
    name, change, _ = CORRUPTIONS[case]
    edit(complete_dir(tmp_path) / name, change)
    assert not kaldi_validates(tmp_path)


def test_full_disk_is_told_with_the_directory(tmp_path):
    (tmp_path / f".text.{os.getpid()}.tmp").symlink_to("/dev/full")
    utterance = OutUtterance("s-1", "s", "r", 0, FS, text="A" * 100_000)
    with pytest.raises(OSError, match="No space left on device") as raised:
        write_data_dir(tmp_path, {"r": ("r.flac", FS)}, [utterance], segmented=True)
    assert raised.value.filename == str(tmp_path)
