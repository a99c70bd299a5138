"""Files that a loss of power damages between two items are made again, to the bytes of an undisturbed run."""

import numpy as np
import pytest
from corpora_examples import put, put_text, rir
from damage import DAMAGES, run_until_assembled, whole_files, work_directories
from datadirs import burst, rir_dir, speech_dir
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.augment import augment
from roomeq.corpora import prepare_speech, read_measured
from roomeq.eq.steps import compensate, fit_eq
from roomeq.simulate_rirs import simulate

AUDIO = (".wav", ".flac")


def simulating(root):
    rows = [row(f"r{n}", source_pos_m=[1.0 + n, 2.0, 1.5], mic_pos_m=[3.0, 3.0, 1.2], source_id=f"s{n}")
            for n in range(2)]
    write_rir_dir(root / "measured", [(item, coloured_rir(0)) for item in rows])
    return lambda: simulate(root / "measured", root / "out", t60_range_s=(0.3, 0.4), num_rays=300, order=20)


def compensating(root):
    measured = [(row(f"r{n}", f"room{n % 3}"), coloured_rir(n, eq_db=(0, n, -n, 0, 0, n, 2, -n))) for n in range(6)]
    simulated = [(item, coloured_rir(9)) for item, _ in measured]
    write_rir_dir(root / "measured", measured)
    write_rir_dir(root / "sim", simulated)
    fit_eq(root / "measured", [root / "sim"], root / "eq", n_components=1, seed=0)
    return lambda: compensate(root / "sim", root / "eq", root / "out", seed=0)


def augmenting(packing):
    def step(root):
        speech_dir(root / "clean")
        rir_dir(root / "rirs")
        return lambda: augment(root / "clean", root / "rirs", root / "out", packing=packing)
    return step


def reading_measured(root):
    for n in range(2):
        put(root / "corpus" / f"rir{n}.wav", rir(str(n), 4000), fs_hz=48000)
    return lambda: read_measured(root / "corpus", root / "out")


def preparing_speech(root):
    rng, rows = np.random.default_rng(0), []
    for role in ("train", "dev", "test"):
        for n in range(2):
            put(root / "speech" / f"{role}{n}.wav", burst(rng, 30000), fs_hz=48000)
            rows.append(f"{role}{n}.wav,HELLO,{role}{n},{role}\n")
    put_text(root / "speech/manifest.csv", "file,transcript,speaker,set\n" + "".join(rows))
    return lambda: prepare_speech(root / "speech", root / "out")


STEPS = dict(simulate=simulating, compensate=compensating, augment=augmenting("recording"),
             augment_utterances=augmenting("utterance"), read_measured=reading_measured,
             prepare_speech=preparing_speech)


@pytest.mark.parametrize("name", STEPS)
def test_damaged_audio_is_made_again(name, tmp_path):
    step = STEPS[name](tmp_path)
    step()
    expected = whole_files(tmp_path / "out")
    assert any(path.endswith(AUDIO) for path in expected)
    for damage in DAMAGES:
        (tmp_path / "out").rename(tmp_path / f"before-{damage.__name__}")
        run_until_assembled(step)
        audio = [path for work in work_directories(tmp_path) for path in sorted(work.rglob("*"))
                 if path.suffix in AUDIO]
        damage(audio[0])
        damage(audio[-1])
        step()
        assert whole_files(tmp_path / "out") == expected, damage.__name__


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_records_are_made_again(damage, tmp_path):
    step = augmenting("recording")(tmp_path)
    step()
    expected = whole_files(tmp_path / "out")
    (tmp_path / "out").rename(tmp_path / "before")
    run_until_assembled(step)
    (work,) = work_directories(tmp_path)
    for path in [*work.glob(".items/*"), *work.glob(".rows/*")]:
        damage(path)
    step()
    assert whole_files(tmp_path / "out") == expected
