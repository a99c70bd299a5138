"""`Reverberate`: alignment, level, draws in worker processes, sample rates, and the interfaces of other toolkits."""

import multiprocessing
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from rirmaker import coloured_rir, row, write_rir_dir

import roomeq
from roomeq.core.audio import write_wav
from roomeq.records.rir_dir import write_rirs

FS = 16000


def speech(seconds=1.0, fs=FS, seed=0):
    rng = np.random.default_rng(seed)
    envelope = np.clip(np.sin(2 * np.pi * 3 * np.arange(int(seconds * fs)) / fs), 0, None)
    return (0.1 * envelope * rng.standard_normal(int(seconds * fs))).astype(np.float32)


def rirs(count=3, fs=FS, seed=0):
    rng = np.random.default_rng(seed)
    found = []
    for n in range(count):
        rir = 0.1 * rng.standard_normal(fs // 2) * np.exp(-np.arange(fs // 2) / (0.05 * fs))
        rir[:100 + 20 * n] = 0.0
        rir[100 + 20 * n] = 1.0
        found.append(rir)
    return found


@pytest.fixture
def rir_dir(tmp_path):
    write_rir_dir(tmp_path / "rirs", [(row(f"r{n}"), coloured_rir(n)) for n in range(4)])
    return tmp_path / "rirs"


def test_length_level_and_alignment_are_kept():
    reverberate = roomeq.Reverberate(rirs(), snr="none")
    click = np.zeros(FS, np.float32)
    click[5000] = 0.9
    for n in range(3):
        result = reverberate(click, FS, key=f"utt{n}")
        assert result.shape == click.shape and result.dtype == np.float32
        assert np.argmax(np.abs(result)) == 5000
        assert not np.any(np.abs(result[:4990]) > 3e-3)  # what lies below 20 Hz is removed
        assert np.sqrt(np.mean(result ** 2)) == pytest.approx(np.sqrt(np.mean(click ** 2)), rel=2e-3)


def test_samples_beyond_full_scale_keep_their_level():
    reverberate, quiet = roomeq.Reverberate(rirs(), snr="none"), speech()
    loud = reverberate(quiet * 32768, FS, key="a")
    assert loud == pytest.approx(reverberate(quiet, FS, key="a") * 32768, rel=1e-3, abs=1.0)


def test_offset_of_the_speech_is_not_reverberated():
    """In geometrical acoustics, all reflections of a constant add up: simulated RIRs raise it by 20 dB."""
    rir = np.zeros(FS // 2, np.float32)
    rir[100], rir[101:] = 1.0, 0.01 * np.exp(-np.arange(FS // 2 - 101) / 1000)
    reverberate = roomeq.Reverberate([rir], [speech(seed=1)], snr="10")
    assert reverberate(speech() + 0.02, FS, key="a") == pytest.approx(reverberate(speech(), FS, key="a"), abs=1e-3)


def test_rumble_below_hearing_is_not_reverberated():
    rir = np.zeros(FS // 2, np.float32)
    rir[100], rir[101:] = 1.0, 0.01 * np.exp(-np.arange(FS // 2 - 101) / 1000)
    reverberate = roomeq.Reverberate([rir], [speech(seed=1)], snr="10")
    rumble = (0.02 * np.sin(2 * np.pi * 3 * np.arange(FS) / FS)).astype(np.float32)
    result, without = reverberate(speech() + rumble, FS, key="a"), reverberate(speech(), FS, key="a")
    assert result / np.std(result) == pytest.approx(without / np.std(without), abs=0.1)


@pytest.mark.parametrize("rumble, offset", [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)])
def test_snr_of_ambient_noise_is_that_of_what_is_heard(rumble, offset):
    clean, time_s = speech(4.0), np.arange(5 * FS) / FS
    noises = [(np.random.default_rng(5).standard_normal(5 * FS) + rumble * np.cos(2 * np.pi * 3 * time_s) + offset
               ).astype(np.float32)]
    with_noise, without = (roomeq.Reverberate(rirs(1), noises, snr=snr)(clean, FS, key="x") for snr in (10, "none"))
    with_noise, without = (np.fft.rfft(samples)[20 * 4:] for samples in (with_noise, without))  # from 20 Hz on
    scale = np.vdot(without, with_noise).real / np.vdot(without, without).real
    noise_power = np.sum(np.abs(with_noise - scale * without) ** 2)
    assert 10 * np.log10(np.sum(np.abs(scale * without) ** 2) / noise_power) == pytest.approx(10.0, abs=0.3)


def test_calls_differ_from_each_other_and_are_the_same_in_another_run():
    first, second = (roomeq.Reverberate(rirs(8), seed=3) for _ in range(2))
    runs = [[reverberate(speech(), FS) for _ in range(6)] for reverberate in (first, second)]
    assert all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    assert len({one.tobytes() for one in runs[0]}) > 2
    assert any(not np.array_equal(a, b)
               for a, b in zip(runs[0], [roomeq.Reverberate(rirs(8), seed=4)(speech(), FS) for _ in range(6)],
                               strict=True))


def _three_calls(reverberate):
    return [reverberate(speech(), FS).tobytes() for _ in range(3)]


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_draw_independently(method):
    reverberate = roomeq.Reverberate(rirs(200), seed=1)
    with multiprocessing.get_context(method).Pool(2) as pool:
        drawn = pool.map(_three_calls, [reverberate] * 2, chunksize=1)
    ours = _three_calls(reverberate)
    assert len({tuple(ours), *map(tuple, drawn)}) >= 2
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.map(_three_calls, [reverberate])[0] != ours


@pytest.mark.parametrize("worker", [None, 7])
@pytest.mark.parametrize("variable", ["RANK", "SLURM_PROCID", "OMPI_COMM_WORLD_RANK", "PMI_RANK", "LOCAL_RANK"])
def test_ranks_of_distributed_training_draw_independently(monkeypatch, variable, worker):
    """Ranks are processes of their own, and `torch.manual_seed` gives their workers the same seed."""
    loader = SimpleNamespace(get_worker_info=lambda: worker and SimpleNamespace(seed=worker))
    monkeypatch.setitem(sys.modules, "torch.utils.data", loader)
    drawn = []
    for rank in (None, "0", "1", "2"):
        monkeypatch.delenv(variable, raising=False) if rank is None else monkeypatch.setenv(variable, rank)
        drawn.append(tuple(_three_calls(roomeq.Reverberate(rirs(200), seed=1))))
    assert drawn[0] == drawn[1] and len(set(drawn)) == 3


def test_copies_of_a_process_draw_one_after_the_other():
    reverberate, other = (roomeq.Reverberate(rirs(8), seed=3) for _ in range(2))
    state = pickle.dumps(reverberate)  # a pool sends one with every task
    drawn = [pickle.loads(state)(speech(), FS) for _ in range(5)] + [reverberate(speech(), FS)]
    np.testing.assert_array_equal(drawn, [other(speech(), FS) for _ in drawn])


def test_probability_is_met_and_other_calls_return_the_speech():
    reverberate, clean = roomeq.Reverberate(rirs(), p=0.5), speech(0.2)
    changed = sum(not np.array_equal(reverberate(clean, FS), clean) for _ in range(200))
    assert 70 < changed < 130


def test_rir_directory_serves_its_rirs(rir_dir):
    reverberate = roomeq.Reverberate(rir_dir, snr="uniform 5 25", seed=2)
    results = {reverberate(speech(), FS, key=f"utt{n}").tobytes() for n in range(5)}
    assert len(results) > 1


def test_rirs_at_a_higher_rate_serve_speech_at_a_lower_one():
    high, low = (roomeq.simulate_rir(roomeq.Room((5, 4, 3), t60_s=0.4), (1, 1, 1.5), (1.6, 1.3, 1.4), fs, num_rays=2000)
                 for fs in (48000, 16000))
    click = np.zeros(FS, np.float32)
    click[3000] = 0.5
    from_high = roomeq.Reverberate([high], snr="none", fs=48000)(click, FS)
    from_low = roomeq.Reverberate([low], snr="none")(click, FS)
    assert abs(int(np.argmax(np.abs(from_high))) - 3000) <= 1 and np.argmax(np.abs(from_low)) == 3000
    assert np.max(np.abs(from_high)) == pytest.approx(np.max(np.abs(from_low)), rel=0.3)


def test_directory_at_another_rate_is_used_at_its_own(rir_dir):
    reverberate = roomeq.Reverberate(rir_dir, snr="none", point_snr="none")
    assert reverberate(speech(1.0, 8000), 8000, key="a").shape == (8000,)
    with pytest.raises(ValueError, match="RIRs at 16000 Hz cannot serve audio at 48000 Hz"):
        reverberate(speech(1.0, 48000), 48000)


@pytest.mark.parametrize("rate", [np.uint16, np.int32, np.float32])
def test_sample_rates_of_numpy_act_like_those_of_python(rate):
    """MAT files hold 48,000 as uint16, in which its product with the delay of an RIR overflows."""
    found, wanted = (roomeq.Reverberate(rirs(fs=48000), [speech(fs=48000)], fs=kind(48000))(
        speech(fs=8000), kind(8000), key="a") for kind in (rate, int))
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize("of", ["arrays", "directory"])
def test_noises_in_memory_are_resampled_to_the_rate_of_the_speech(rir_dir, of):
    tone = np.sin(2 * np.pi * 3000 * np.arange(2 * FS) / FS).astype(np.float32)
    reverberate = roomeq.Reverberate(rirs() if of == "arrays" else rir_dir, [tone], snr=-60, point_snr="none")
    for fs in (8000, FS):
        assert np.argmax(np.abs(np.fft.rfft(reverberate(speech(1.0, fs), fs)))) == pytest.approx(3000, abs=2)


def test_noises_in_memory_at_a_lower_rate_are_refused(tmp_path):
    write_wav(tmp_path / "r.wav", coloured_rir(0), 48000)
    write_rirs(tmp_path, [row("r", wav="r.wav", fs_hz=48000, n_samples=len(coloured_rir(0)))])
    with pytest.raises(ValueError, match="noises at 16000 Hz cannot serve audio at 48000 Hz.*noises with fs=48000"):
        roomeq.Reverberate(tmp_path, [speech()])(speech(1.0, 48000), 48000)


def test_noise_of_which_resampling_leaves_nothing_is_refused():
    with pytest.raises(ValueError, match="noise 0: nothing of it is left at 8000 Hz"):
        roomeq.Reverberate(rirs(fs=48000), [np.array([1.0, -1.0])], fs=48000)(speech(1.0, 8000), 8000)


def test_one_channel_keeps_its_shape_and_several_are_refused():
    reverberate = roomeq.Reverberate(rirs())
    assert reverberate(speech()[None], FS).shape == (1, FS)
    with pytest.raises(ValueError, match="must be that of one channel"):
        reverberate(np.stack([speech(), speech()]), FS)


def test_result_is_not_the_array_that_was_given():
    clean = speech(0.2)
    for reverberate, samples in ((roomeq.Reverberate(rirs(), p=0.0), clean), (roomeq.Reverberate(rirs()), 0.0 * clean)):
        result = reverberate(samples, FS)
        assert np.array_equal(result, samples) and not np.shares_memory(result, samples)


def test_silence_is_returned_as_it_is():
    faint = np.float32(1e-30) * speech()  # whose power is 0 in single precision
    np.testing.assert_array_equal(roomeq.Reverberate(rirs())(faint, FS), faint)
    for offset in (0.0, -2.0 ** -15):  # sound cards add a constant
        silence = np.full(800, offset, np.float32)
        np.testing.assert_array_equal(roomeq.Reverberate(rirs())(silence, FS), silence)


@pytest.mark.parametrize(("wrong", "message"), [
    (lambda: roomeq.Reverberate([]), "rirs is empty"),
    (lambda: roomeq.Reverberate("hall.wav"), r"hall\.wav/rirs\.jsonl: no such file: .*roomeq read-measured"),
    (lambda: roomeq.Reverberate(rirs()[0]), r"rirs: shape \(8000,\) is that of one recording, .* give \[samples\]"),
    (lambda: roomeq.Reverberate(np.stack(rirs(2), axis=1)), r"rirs: .* one recording of 2 channels, .* in samples.T"),
    (lambda: roomeq.Reverberate(rirs(), noises=np.ones((800, 4))), r"noises: .* one recording of 4 channels"),
    (lambda: roomeq.Reverberate(rirs(), noises=np.ones(800)), r"noises: shape \(800,\) is that of one recording"),
    (lambda: roomeq.Reverberate([np.zeros(100)]), "RIR 0: silent"),
    (lambda: roomeq.Reverberate(rirs(), noises=[np.full(800, 0.5)]), "noise 0: silent"),
    (lambda: roomeq.Reverberate([np.full(100, np.nan)]), "RIR 0: holds NaN"),
    (lambda: roomeq.Reverberate(["a.wav", "b.wav"]), "RIR 0 'a.wav' is a path: must be samples: read the file"),
    (lambda: roomeq.Reverberate(rirs(), noises=[Path("hum.wav")]), "noise 0 'hum.wav' is a path: must be samples"),
    (lambda: roomeq.Reverberate(rirs())("speech.wav", FS), "samples 'speech.wav' is a path: must be samples"),
    (lambda: roomeq.plot_rir("hall.wav", FS), "impulse response 'hall.wav' is a path: must be samples"),
    (lambda: roomeq.Reverberate(rirs(), snr="loud"), "snr='loud' must be"),
    (lambda: roomeq.Reverberate(rirs(), p=2.0), r"p=2.0 must lie in \[0, 1\]"),
    (lambda: roomeq.Reverberate(rirs(), p=None), r"p=None must lie in \[0, 1\]"),
    (lambda: roomeq.Reverberate(rirs(), point_noise_prob="0.5"), r"point_noise_prob='0.5' must lie in \[0, 1\]"),
    (lambda: roomeq.Reverberate(rirs(), seed="a"), "seed='a' must be a whole number"),
    (lambda: roomeq.Reverberate(rirs(), noises="data/noises"), "go with an RIR directory"),
    (lambda: roomeq.Reverberate(rirs())(np.array([np.inf]), FS), "samples: holds NaN"),
    (lambda: roomeq.Reverberate(rirs())(np.ones(9, complex), FS), "samples holds complex numbers: must be samples"),
    (lambda: roomeq.analyse(rirs()[0], FS, direct=(-500, 1)), "direct_sample=-500 must lie in"),
    (lambda: roomeq.analyse(rirs()[0], FS, direct=(100, 7)), "polarity 7 must be 1 or -1"),
    (lambda: roomeq.Reverberate(rirs())(speech(), 96000), "fs=96000 must be"),
    (lambda: roomeq.Reverberate(rirs(), p=0.0)(speech(), 0), "fs=0 must be"),
    (lambda: roomeq.Reverberate(rirs())(speech(), None), "fs=None must be"),
])
def test_wrong_arguments_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


def test_import_needs_no_torch():
    import subprocess
    import sys

    code = "import sys, roomeq; roomeq.Reverberate; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"


def test_chain_of_audiomentations_holds_it():
    audiomentations = pytest.importorskip("audiomentations")
    chain = audiomentations.Compose([audiomentations.Gain(p=1.0), roomeq.Reverberate(rirs())])
    assert chain(samples=speech(), sample_rate=FS).shape == (FS,)


def test_torch_workers_draw_independently():
    torch = pytest.importorskip("torch")

    class Utterances(torch.utils.data.Dataset):
        def __init__(self):
            self.reverberate = roomeq.Reverberate(rirs(100))

        def __len__(self):
            return 8

        def __getitem__(self, n):
            return self.reverberate(speech(0.1), FS)

    def epoch():
        loader = torch.utils.data.DataLoader(Utterances(), batch_size=None, num_workers=2)
        return [np.asarray(one).tobytes() for one in loader]

    torch.manual_seed(0)
    first, second = epoch(), epoch()
    torch.manual_seed(0)
    assert epoch() == first and first != second and len(set(first)) > 5


def test_lhotse_augments_features_with_it(tmp_path):
    lhotse = pytest.importorskip("lhotse")
    soundfile.write(tmp_path / "a.wav", speech(), FS)
    cut = lhotse.MonoCut("a", 0, 1.0, 0, recording=lhotse.Recording.from_file(tmp_path / "a.wav"))
    with_, without = (cut.compute_features(lhotse.Fbank(), augment_fn=augment)
                      for augment in (roomeq.Reverberate(rirs()), None))
    assert with_.shape == without.shape and not np.allclose(with_, without)
