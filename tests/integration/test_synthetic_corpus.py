"""The synthetic corpora: layout, determinism and physics."""

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.signal import butter, sosfiltfilt

import make_synthetic_rirs
import make_synthetic_speech
import synthetic_acoustics as acoustics
import synthetic_text
from roomeq.corpora import read_measured
from roomeq.records.rir_dir import read_rirs

LOCAL = Path(__file__).parents[2] / "local"

SMALL = {"speech": ["--utterances", "16,4,8"],
         "rirs": ["--rooms", "3", "--mics", "2", "--speakers", "1", "--silence-s", "1"]}
CORPUS = make_synthetic_rirs.Corpus(rooms=3, mics=2, speakers=1, silence_s=1, seed=0)  # the same options


def command(kind, out_dir, *options):
    return [sys.executable, str(LOCAL / f"make_synthetic_{kind}.py"), *SMALL[kind], *options, str(out_dir)]


def make(kind, out_dir, *options):
    return subprocess.run(command(kind, out_dir, *options), check=True, capture_output=True, text=True)


def contents(folder):
    """Return all files by path, except the stamp, which holds the version of the package."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*")
            if path.is_file() and path.name != ".done"}


@pytest.fixture(scope="module")
def speech(tmp_path_factory):
    out_dir = tmp_path_factory.mktemp("synthetic") / "speech"
    make("speech", out_dir)
    return out_dir


@pytest.fixture(scope="module")
def rirs(tmp_path_factory):
    out_dir = tmp_path_factory.mktemp("synthetic") / "rirs"
    make("rirs", out_dir)
    return out_dir


def transcripts(folder):
    return [line.split(" ", 1) for path in folder.rglob("*.trans.txt") for line in path.read_text().splitlines()]


# Both


@pytest.mark.parametrize("kind", SMALL)
def test_killed_run_with_two_jobs_gives_the_same_bytes(kind, tmp_path, request):
    killed = subprocess.Popen(command(kind, tmp_path / "b", "--nj", "2"), start_new_session=True,
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while killed.poll() is None and not list(tmp_path.glob(".b.part-*/.items/*.json")):
        time.sleep(0.01)
    assert killed.poll() is None, "the run ended before it was killed"
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    assert not (tmp_path / "b").exists()
    make(kind, tmp_path / "b", "--nj", "2")
    assert contents(tmp_path / "b") == contents(request.getfixturevalue(kind))


def test_another_seed_gives_other_audio(speech, rirs, tmp_path):
    session = next(iter(make_synthetic_rirs.sessions(CORPUS).values()))
    make_synthetic_rirs.make_session(replace(CORPUS, seed=1), tmp_path, session.folder, session)
    chapter = next(iter(make_synthetic_speech.chapters((16, 4, 8)).values()))
    make_synthetic_speech.make_chapter(1, tmp_path, chapter)
    make_synthetic_speech.make_noise(1, tmp_path, "hum1")
    seed_1, seed_0 = contents(tmp_path), contents(speech) | contents(rirs)
    audio = [name for name in seed_1 if name.endswith((".wav", ".flac"))]
    assert len(audio) >= 6 and all(seed_1[name] != seed_0[name] for name in audio)


@pytest.mark.parametrize("kind", SMALL)
def test_readme_says_that_the_corpus_is_generated(kind, request):
    assert "Generated, not" in (request.getfixturevalue(kind) / "README").read_text()


@pytest.mark.parametrize("kind", SMALL)
def test_foreign_output_directory_is_left_alone(kind, tmp_path):
    (tmp_path / "notes").write_text("mine")
    done = subprocess.run(command(kind, tmp_path), capture_output=True, text=True)
    assert done.returncode == 1
    assert re.fullmatch(rf"make_synthetic_{kind}\.py: .*not made by.*\n", done.stderr)
    assert contents(tmp_path) == {"notes": b"mine"}


@pytest.mark.parametrize(("kind", "options"), [
    ("speech", ["--utterances", "16,4,7"]), ("speech", ["--utterances", "99"]), ("speech", ["--nj", "0"]),
    ("rirs", ["--rooms", "81"]), ("rirs", ["--silence-s", "0"])])
def test_options_out_of_range_are_refused(kind, options, tmp_path):
    done = subprocess.run(command(kind, tmp_path / "b", *options), capture_output=True, text=True)
    assert done.returncode == 2
    assert re.search(f"{options[0]}:? {options[1]} must", done.stderr)


@pytest.mark.parametrize("kind", SMALL)
def test_help_has_an_example(kind):
    done = subprocess.run(command(kind, "x", "--help"), check=True, capture_output=True, text=True)
    assert f"e.g.:  python local/make_synthetic_{kind}.py" in done.stdout


# Speech


def test_speech_has_the_librispeech_layout(speech):
    for path in (speech / "LibriSpeech").rglob("*.flac"):
        speaker, chapter, number = path.stem.split("-")
        assert path.parts[-3:-1] == (speaker, chapter) and re.fullmatch(r"\d{4}", number)
        info = soundfile.info(path)
        assert (info.samplerate, info.channels, info.subtype) == (16000, 1, "PCM_16")
        assert 1 <= info.duration <= 7
    audio = {path.stem for path in (speech / "LibriSpeech").rglob("*.flac")}
    assert len(audio) == 28
    assert {name for name, _ in transcripts(speech)} == audio


def test_speakers_are_listed_and_belong_to_one_set(speech):
    lines = (speech / "LibriSpeech/SPEAKERS.TXT").read_text().splitlines()
    rows = [[field.strip() for field in line.split("|")] for line in lines if not line.startswith(";")]
    assert {row[0]: row[2] for row in rows} == {path.name: path.parent.name
                                                for path in (speech / "LibriSpeech").glob("*/*") if path.is_dir()}
    assert Counter(row[2] for row in rows) == {"train-clean-100": 16, "dev-clean": 4, "test-clean": 8}
    assert Counter(row[1] for row in rows) == {"M": 14, "F": 14}
    assert len({row[4].split("+")[1] for row in rows}) == 28
    assert all(float(row[3]) > 0 for row in rows)


def test_each_set_has_the_requested_utterances():
    counts = Counter()
    for chapter in make_synthetic_speech.chapters((900, 150, 1200)).values():
        counts[chapter.subset] += chapter.n_utterances
    assert counts == {"train-clean-100": 900, "dev-clean": 150, "test-clean": 1200}


def test_sentences_hold_vocabulary_words_only(speech):
    vocabulary = {word.upper() for word in synthetic_text.VOCABULARY}
    assert 150 <= len(vocabulary) <= 200
    spoken = [text for _, text in transcripts(speech)]
    read = (speech / "LibriSpeech-LM/lm.txt").read_text().splitlines()
    assert len(read) == 20_000 and set(" ".join(read).split()) == vocabulary
    for sentences in (spoken, read):
        assert all(set(text.split()) <= vocabulary and 3 <= len(text.split()) <= 10 for text in sentences)
    assert Counter(len(text.split()) for text in read).keys() == set(range(3, 11))
    assert read[:len(spoken)] != spoken


def test_no_two_words_are_homophones_in_any_language():
    with make_synthetic_speech.Espeak() as espeak:
        for language in {voice.language for voices in make_synthetic_speech.VOICES.values() for voice in voices}:
            spoken = espeak.phonemes(language, synthetic_text.VOCABULARY)
            assert len(set(spoken)) == len(synthetic_text.VOCABULARY), language


def perplexity(order, sentences, held_out):
    """Return the perplexity of sentences under an n-gram model with Witten-Bell smoothing."""
    following = defaultdict(Counter)
    for words in sentences:
        padded = ["<s>"] * (order - 1) + words
        for n in range(order - 1, len(padded)):
            for length in range(order):
                following[tuple(padded[n - length:n])][padded[n]] += 1

    def probability(word, context):
        shorter = probability(word, context[1:]) if context else 1 / len(synthetic_text.VOCABULARY)
        seen = following.get(context, {})
        return (seen.get(word, 0) + len(seen) * shorter) / (sum(seen.values()) + len(seen)) if seen else shorter

    bits = [-np.log2(probability(word, tuple((["<s>"] * (order - 1) + words[:n])[n:])))
            for words in held_out for n, word in enumerate(words)]
    return 2 ** np.mean(bits)


def test_perplexity_falls_with_ngram_order():
    sentences = [line.lower().split() for line in make_synthetic_speech.lm_text(0).splitlines()]
    held_out = [synthetic_text.draw_sentence(0, np.random.default_rng(n)) for n in range(300)]
    unigram, bigram, trigram = (perplexity(order, sentences, held_out) for order in (1, 2, 3))
    assert unigram > 1.8 * bigram and bigram > 1.2 * trigram and 20 < trigram < 60


def test_speech_has_levels_and_no_digital_silence(speech):
    peaks_db = []
    for path in (speech / "LibriSpeech").rglob("*.flac"):
        samples, _ = soundfile.read(path)
        peaks_db.append(20 * np.log10(np.abs(samples).max()))
        assert -67 < 20 * np.log10(samples[:1600].std()) < -63
    assert -10.1 < min(peaks_db) < max(peaks_db) < -2.9
    assert np.std(peaks_db) > 1


def test_utterance_does_not_depend_on_earlier_ones():
    voice = make_synthetic_speech.VOICES["test-clean"][1]  # a breathy voice, which draws random numbers
    with make_synthetic_speech.Espeak() as espeak:
        first, again = (make_synthetic_speech.say(espeak, voice, ["open", "door"], np.random.default_rng(1))
                        for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_unknown_voice_raises_one_line():
    voice = make_synthetic_speech.Voice("M", "xx", "m1", 160, 50, 50)
    with make_synthetic_speech.Espeak() as espeak, pytest.raises(OSError, match="eSpeak NG ended at .*xx"):
        make_synthetic_speech.say(espeak, voice, ["open"], np.random.default_rng(0))


def test_point_noises_are_listed(speech):
    listed = (speech / "point_noises/noises.csv").read_text().splitlines()
    assert listed[0] == "file,kind" and len(listed) == 13
    audio = list((speech / "point_noises").glob("*.flac"))
    assert {line.split(",")[0] for line in listed[1:]} == {path.name for path in audio}
    for path in audio:
        samples, fs_hz = soundfile.read(path)
        assert fs_hz == 16000 and 5 <= len(samples) / fs_hz <= 10
        assert -28 < 20 * np.log10(samples.std()) < -22.9


# RIRs: layout


def read_meta(path):
    return dict(line[1:].split("\t") for line in path.read_text().splitlines() if "\t" in line)


def test_rirs_have_the_reverbdb_layout(rirs):
    files = [str(path.relative_to(rirs)) for path in rirs.rglob("*.wav")]
    pattern = re.compile(r"Standin_\w+/MicID01/SpkID\d\d_20\d{6}_[ST]/\d\d/"
                         r"(RIR/IR_sweep_15s_45Hzto22kHz_FS16kHz\.v0[01]\.wav|silence/silence\.v0[01]\.wav|english/.*)")
    assert all(pattern.fullmatch(name) for name in files)
    assert sum("/RIR/" in name for name in files) == 3 * 2 + 2 + 2  # positions, second takes, retransmission
    for path in rirs.rglob("RIR/*.wav"):
        info = soundfile.info(path)
        assert (info.samplerate, info.channels, info.frames) == (16000, 1, 16000)
        assert 0.005 < np.abs(soundfile.read(path)[0]).max() < 1


def test_mic_meta_describes_the_position(rirs):
    for path in rirs.rglob("mic_meta.txt"):
        values, speaker = read_meta(path), read_meta(path.parents[1] / "spk_meta.txt")
        assert speaker.items() <= values.items()
        number = values["EnvMicID"]
        assert path.parent.name == f"{int(number):02d}"
        axes = "Depth", "Width", "Height"
        apart = [float(values[f"EnvMic{number}{a}"]) - float(values[f"EnvSpk1{a}"]) for a in axes]
        assert float(values[f"EnvMic{number}RelDistance"]) == pytest.approx(np.linalg.norm(apart), abs=0.006)


def test_corpus_holds_the_irregularities_of_reverbdb(rirs):
    rooms = {path.parent.name: read_meta(path) for path in rirs.glob("*/env*_meta.txt")}
    assert sum("EnvFurniture" not in values for values in rooms.values()) == 1
    assert any(values["EnvType"] == "stairs" for values in rooms.values())
    assert len(list(rirs.glob("*/env_full_meta.txt"))) == 1
    assert len(list(rirs.glob("*/*/*_T"))) == 1
    assert len(list(rirs.rglob("*.v01.wav"))) == 3  # two RIRs, one silence
    outside = [path for path in rirs.rglob("mic_meta.txt") for values in [read_meta(path)]
               if float(values[f"EnvMic{values['EnvMicID']}Depth"]) > float(rooms[path.parts[-5]]["EnvDepth"])]
    assert {path.parts[-2] for path in outside} == {"02"} and len(outside) == 2


def test_silence_recordings_hold_uncorrelated_noise(rirs):
    noises = [soundfile.read(path)[0] for path in rirs.rglob("silence/*.wav")]
    assert len(noises) == 3 * 2 + 1
    assert all(-62 < 20 * np.log10(noise.std()) < -38 for noise in noises)
    assert np.abs(np.corrcoef(noises) - np.eye(7)).max() < 0.5


def test_direct_sound_and_noise_floor_match_reverbdb(rirs):
    for path in rirs.rglob("RIR/*.wav"):
        samples, _ = soundfile.read(path)
        assert 709 < np.abs(samples[600:725]).argmax() + 600 < 716
        assert -70 < 20 * np.log10(samples[:300].std() / np.abs(samples).max()) < -50


def test_second_takes_differ_in_noise_only(rirs):
    for second in rirs.rglob("RIR/*.v01.wav"):
        first, _ = soundfile.read(second.with_name(second.name.replace("v01", "v00")))
        difference = soundfile.read(second)[0] - first
        assert 0 < difference.std() < 0.01 * np.abs(first).max()


# RIRs: physics

DIMS_M = np.array([7.8, 5.2, 3.1])
T60_S = 0.6 * np.array([1.5, 1.35, 1.2, 1.1, 1, 0.95, 0.9, 0.85])


@pytest.fixture(scope="module")
def room():
    return acoustics.Room(DIMS_M, T60_S, np.ones(6), 0.2, 20.0, 1)


@pytest.fixture(scope="module")
def positions():
    rng = np.random.default_rng(5)
    source_m = np.array([1.3, 3.9, 1.5])
    mics_m = rng.uniform(0.5, DIMS_M - 0.5, (40, 3))
    return source_m, mics_m[np.linalg.norm(mics_m - source_m, axis=1) > 1.5][:16]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_modes_peak_at_half_wavelengths(room, axis):
    dims_m = np.roll([7.0, 3.0, 2.6], axis)  # no other mode is near those along the longest side
    longest = replace(room, dims_m=dims_m)
    corner, opposite, middle = np.zeros(3), dims_m * (np.arange(3) == axis), dims_m / 2 * (np.arange(3) == axis)
    field = np.abs(acoustics.modal_spectra(longest, corner, np.array([opposite, middle]), 100))
    expected_hz = room.c_m_s / 14
    first, second = (np.abs(acoustics.FREQS_HZ - n * expected_hz) < 4 for n in (1, 2))
    assert acoustics.FREQS_HZ[first][field[0, first].argmax()] == pytest.approx(expected_hz, abs=0.6)
    assert acoustics.FREQS_HZ[second][field[1, second].argmax()] == pytest.approx(2 * expected_hz, abs=1)
    assert field[1, first].max() < 0.3 * field[0, first].max()  # a node in the middle of the room


def test_image_sources_are_mirrored_at_the_walls(room):
    source_m = np.array([1.0, 2.0, 0.5])
    positions_m, mirrored, hits = acoustics.image_sources(room, source_m)
    assert len(positions_m) == 63  # 1 + 6 + 18 + 38 images of orders 0 to 3
    for start, length, low, high in zip(source_m, DIMS_M, hits.T[::2], hits.T[1::2], strict=True):
        assert np.all(np.abs(low - high) <= 1)
        assert {0, 1, 2} == set(high) and start < length
    along_x = np.flatnonzero((hits[:, 2:] == 0).all(1))
    found = {round(positions_m[k, 0], 6): tuple(hits[k, :2]) for k in along_x}
    assert found == {1.0: (0, 0), -1.0: (1, 0), 14.6: (0, 1), 16.6: (1, 1), -14.6: (1, 1), -16.6: (2, 1),
                     30.2: (1, 2)}
    assert np.array_equal(mirrored, 1 - 2 * (hits.reshape(-1, 3, 2).sum(2) % 2))


def reach(room, source_m, mic_m, facing=(1.0, 0, 0), seed=0):
    return acoustics.early_and_tail(room, source_m, mic_m, np.array(facing), np.random.default_rng(seed))


def test_direct_sound_is_that_of_a_point_source(room):
    source_m, mic_m = np.array([2.0, 2.0, 1.5]), np.array([4.0, 2.5, 1.6])
    distance_m = np.linalg.norm(mic_m - source_m)
    early, _ = reach(room, source_m, mic_m, (mic_m - source_m) / distance_m)
    pulse = np.fft.irfft(early)
    arrival = distance_m / room.c_m_s * 16000
    wave = np.fft.rfft(pulse[:int(arrival) + 30], 4096)  # before the first reflection
    middle = slice(256, 1025)  # 1-4 kHz
    assert 20 * np.log10(np.abs(wave[middle]).mean() * 4 * np.pi * distance_m) == pytest.approx(0, abs=0.5)


def decay_time_s(response, centre_hz):
    edges_hz = centre_hz * 2 ** np.array([-0.5, 0.5])
    band = sosfiltfilt(butter(3, edges_hz, "bandpass", fs=16000, output="sos"), response)[800:15000]
    level_db = 10 * np.log10(np.cumsum(band[::-1] ** 2)[::-1])
    chosen = np.flatnonzero((level_db < level_db[0] - 5) & (level_db > level_db[0] - 35))
    return -60 / np.polyfit(chosen / 16000, level_db[chosen], 1)[0]


def render(room, source_m, mics_m, model=0):
    rngs = [np.random.default_rng(k) for k in range(len(mics_m))]
    return acoustics.impulse_responses(room, source_m, mics_m, np.array([1.0, 0, 0]),
                                       np.full(len(mics_m), 712.0), rngs, model)


@pytest.mark.parametrize("octave", [1, 2, 3, 4, 5, 6])
def test_decay_is_the_nominal_one(room, positions, octave):
    times_s = [decay_time_s(response, acoustics.OCTAVES_HZ[octave]) for response in render(room, *positions)]
    assert np.mean(times_s) == pytest.approx(room.total_t60_s[octave], rel=0.08)


def test_diffuse_level_is_that_of_the_absorption_area(room, positions):
    source_m, mics_m = positions
    band = np.abs(np.log2(acoustics.FREQS_HZ.clip(1) / 500)) < 0.25
    tails = [reach(room, source_m, mic_m, seed=k)[1] for k, mic_m in enumerate(mics_m)]
    late = np.sum(np.fft.irfft(np.array(tails) * band)[:, 1600:] ** 2, 1)
    t60_s = room.total_t60_s[3]
    absorption_m2 = 55.26 * room.volume_m3 / (room.c_m_s * t60_s)
    # 4/A of the source's power 1/(4 pi), decayed for 0.1 s; the loudspeaker radiates a little less to its back
    expected = np.mean(band) / (np.pi * absorption_m2) * np.exp(-13.8 * 0.1 / t60_s)
    assert 10 * np.log10(np.mean(late) / expected) == pytest.approx(-0.5, abs=1)


def test_modal_and_ray_parts_match_at_the_crossover(room, positions):
    source_m, mics_m = positions
    band = np.abs(np.log2(acoustics.FREQS_HZ.clip(1) / room.crossover_hz)) < 0.4
    modal = acoustics.modal_spectra(room, source_m, mics_m, room.crossover_hz * np.sqrt(2))
    upper = [sum(reach(room, source_m, mic_m, seed=k)) for k, mic_m in enumerate(mics_m)]
    levels = [np.mean(np.abs(np.array(field)[:, band]) ** 2) for field in (modal, upper)]
    assert 10 * np.log10(levels[0] / levels[1]) == pytest.approx(0, abs=1.5)


def test_loudspeaker_is_audible_in_every_room(room, positions):
    power = np.mean(np.abs(np.fft.rfft(render(room, *positions), 32768)) ** 2, 0)

    def level_db(centre_hz, width_octaves):
        near = np.abs(np.log2(acoustics.FREQS_HZ.clip(1) / centre_hz)) < width_octaves / 2
        return 10 * np.log10(power[near].mean())

    assert level_db(170, 0.4) - level_db(40, 0.4) > 8  # high-pass at 80 Hz and resonance at 170 Hz
    assert level_db(2700, 0.3) - level_db(1300, 0.3) > 1.5  # resonance at 2.7 kHz
    assert level_db(1300, 0.3) - level_db(7500, 0.2) > 2  # roll-off


def test_nothing_precedes_the_direct_sound(room, positions):
    for response in render(room, *positions):
        # removes ringing at half the sampling rate, which comes from the fractional shift
        smooth = np.convolve(response, np.hanning(18) / 8.5, "same")
        assert np.abs(smooth[:712 - 48]).max() < 1e-3 * np.abs(smooth).max()


def test_loudspeakers_differ_in_response_only(room, positions):
    first, second = (np.fft.rfft(render(room, *positions, model), 32768)[:, 200:15000] for model in (0, 1))
    frequency_hz = acoustics.FREQS_HZ[200:15000]
    gain_db = 20 * np.log10(np.abs(acoustics.loudspeaker(frequency_hz, 1) / acoustics.loudspeaker(frequency_hz, 0)))
    measured_db = 20 * np.log10(np.median(np.abs(second / first), axis=0))
    assert np.ptp(gain_db) > 8
    assert np.percentile(np.abs(measured_db - gain_db), 95) < 0.5  # the responses end at 1 s
    speakers = {session.speaker: session.model for session in make_synthetic_rirs.sessions(
        make_synthetic_rirs.Corpus(9, 6, 6, 10, 0)).values()}
    assert speakers == {1: 0, 2: 1, 3: 0, 4: 1, 5: 0, 6: 1}


def test_corpus_states_geometry_but_no_hidden_effects(rirs):
    read_measured(rirs, rirs.parent / "measured")
    rows = read_rirs(rirs.parent / "measured")
    assert all(None not in (*row["room_dims_m"], *row["source_pos_m"], *row["mic_pos_m"]) for row in rows)
    assert not any(row.get("source_dir") for row in rows) and {row["source_id"] for row in rows} == {"SpkID01"}
    imports = {line for path in (LOCAL / "synthetic_acoustics.py", LOCAL / "make_synthetic_rirs.py")
               for line in path.read_text().splitlines() if "roomeq" in line and "import" in line}
    assert all(line.split()[1] in ("roomeq.core.audio", "roomeq.core.build", "roomeq.core.files",
                                      "roomeq.core.rng") for line in imports)


def test_loudspeaker_is_directional(room):
    mic_m, source_m = np.array([5.0, 2, 1.5]), np.array([2.0, 2, 1.5])
    towards, away = (reach(room, source_m, mic_m, (side, 0, 0)) for side in (1.0, -1.0))
    direct = [np.fft.rfft(np.fft.irfft(early)[:170], 4096) for early, _ in (towards, away)]  # before reflections
    loss_db = 20 * np.log10(np.abs(direct[0]) / np.abs(direct[1]))
    assert loss_db[128] == pytest.approx(1, abs=0.5)  # 500 Hz
    assert loss_db[1024] == pytest.approx(5, abs=0.7)  # 4 kHz
    np.testing.assert_array_equal(towards[1], away[1])


def test_rooms_are_plausible_and_positions_inside():
    corpus = make_synthetic_rirs.Corpus(80, 6, 6, 10, 0)
    names = set()
    for index in range(corpus.rooms):
        name, kind, _, dims_m, t60_s, *_ = make_synthetic_rirs.describe_room(corpus, index)
        names.add(name)
        room = make_synthetic_rirs.draw_room(corpus, index)
        assert 35 < room.volume_m3 < 2000, name
        assert 0.22 < room.total_t60_s[4] < 1.4
        assert kind == "stairs" or 0.25 <= t60_s <= 1.2
        assert room.total_t60_s[0] > room.total_t60_s[4] > room.total_t60_s[7]
        assert np.average(room.wall_share, weights=room.wall_areas_m2) == pytest.approx(1)
        assert room.wall_absorption[:, 4].max() < 0.95
        speakers, facing, mics = make_synthetic_rirs.draw_positions(corpus, index)
        for positions_m in (speakers, mics):
            assert np.all(positions_m > 0.25) and np.all(positions_m < np.array(dims_m) - 0.25)
        assert np.linalg.norm(speakers[:, None] - mics, axis=2).min() > 0.9
        np.testing.assert_allclose(np.linalg.norm(facing, axis=1), 1)
    assert len(names) == 80 and len(make_synthetic_rirs.sessions(corpus)) == 80 * 6 + 1


def test_drawn_rooms_do_not_depend_on_their_number():
    few, many, other = (make_synthetic_rirs.Corpus(rooms, 3, 3, 10, seed)
                        for rooms, seed in ((10, 0), (80, 0), (80, 1)))
    assert make_synthetic_rirs.describe_room(few, 9) == make_synthetic_rirs.describe_room(many, 9)
    assert make_synthetic_rirs.describe_room(other, 9) != make_synthetic_rirs.describe_room(many, 9)
    drawn = [make_synthetic_rirs.describe_room(many, index) for index in range(9, 80)]
    assert {kind for _, kind, *_ in drawn} == {kind for kind, *_ in make_synthetic_rirs.KINDS}
    decays_s = [t60_s for _, _, _, _, t60_s, *_ in drawn]
    assert min(decays_s) < 0.35 and max(decays_s) > 0.95
