"""The band of an excitation and comparable levels, read off recordings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, resample_poly, sosfilt

from roomeq.acoustics.excitation import NO_END_HZ, excited_from_hz, excited_to_hz
from roomeq.core.constants import FS_HZ
from roomeq.effects.wavefield import damping_per_s, modal_response, modes
from roomeq.loop.data import Data
from roomeq.loop.features import BAND_HZ, CALIBRATION_FEATURES, METRIC, excited, measure_features
from roomeq.loop.measurability import comparable_levels, limit_to_excitation
from roomeq.sim.scene import Shoebox


def response(seed, *, from_hz=None, order=20, amplitude=1.0):
    """Return decaying noise with a direct sound, as a sweep from `from_hz` would measure it."""
    rng = np.random.default_rng(seed)
    t = np.arange(FS_HZ) / FS_HZ
    rir = np.concatenate([np.zeros(200), rng.standard_normal(FS_HZ) * 10.0 ** (-3.0 * t / 0.5)])
    rir[200] += 5.0
    if from_hz:
        rir = sosfilt(butter(order, from_hz, "high", fs=FS_HZ, output="sos"), rir)
    return amplitude * rir


@pytest.mark.parametrize("from_hz", [60.0, 100.0, 200.0])
def test_lower_end_of_a_sweep_is_found_within_a_third_octave(from_hz):
    found = [excited_from_hz(response(seed, from_hz=from_hz)) for seed in range(8)]
    assert np.all(np.abs(np.log2(np.array(found) / from_hz)) < 1.0 / 3.0)


def narrowed(rir, rate_hz):
    """Return a response that was recorded at a lower sample rate."""
    return resample_poly(resample_poly(rir, rate_hz, FS_HZ), FS_HZ, rate_hz)[:len(rir)]


@pytest.mark.parametrize("rate_hz", [6000, 8000, 11025])
@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_upper_end_of_a_recording_is_found_within_a_third_octave(rate_hz, noise):
    rng = np.random.default_rng(0)
    found = [excited_to_hz(narrowed(response(seed), rate_hz) + noise * rng.standard_normal(FS_HZ + 200))
             for seed in range(8)]
    assert np.all(np.abs(np.log2(np.array(found) / (0.5 * rate_hz))) < 1.0 / 3.0)


@pytest.mark.parametrize("order, to_hz", [(4, 2000.0), (4, 6000.0), (8, 4000.0), (100, 7500.0)])
def test_roll_off_of_devices_and_an_anti_alias_filter_are_no_upper_end(order, to_hz):
    """A tweeter of 24 dB per octave, one behind a microphone that falls by as much, and a filter below 8 kHz."""
    frequency_hz = np.fft.rfftfreq(2 * FS_HZ, 1.0 / FS_HZ)
    gain = 1.0 / np.sqrt(1.0 + (frequency_hz / to_hz) ** (2 * order))
    rirs = [np.fft.irfft(gain * np.fft.rfft(response(seed), 2 * FS_HZ))[:FS_HZ] for seed in range(4)]
    assert [excited_to_hz(rir) for rir in rirs] == [NO_END_HZ] * 4


def test_features_above_a_recording_are_invalid_in_its_room_alone(caplog):
    whole = [measure_features(response(seed)) for seed in range(6)]
    features = [measure_features(narrowed(response(seed), 8000)) if seed < 3 else whole[seed] for seed in range(6)]
    rows = [dict(source_id="s", room_id="narrow" if seed < 3 else "wide") for seed in range(6)]
    with caplog.at_level("INFO"):
        limited = limit_to_excitation(rows, features)
    high, low = BAND_HZ > 3800.0, BAND_HZ < 3000.0
    assert not any(of_rir.valid[high].any() for of_rir in limited[:3])
    assert all((of_rir.valid == of_whole.valid)[low & (METRIC != "drr")].all()
               for of_rir, of_whole in zip(limited[:3], whole, strict=False))
    assert all((of_rir.valid == of_whole.valid).all() for of_rir, of_whole in zip(limited[3:], whole[3:], strict=True))
    assert "source s: 3 of 6 RIRs hold nothing above" in caplog.text


def test_octaves_outside_the_excitation_have_no_white_noise():
    """A noisy recording hides the lower end of its sweep, which other recordings of the source show."""
    rirs = [response(seed, from_hz=150.0) for seed in range(4)]
    rirs[0] += 0.05 * np.random.default_rng(0).standard_normal(len(rirs[0]))
    features = [measure_features(rir) for rir in rirs]
    assert features[0].excited_from_hz == 0.0 and 10.0 * np.log10(features[0].white[0]) > -30.0
    limited = limit_to_excitation([dict(source_id="s", room_id="r")] * 4, features)
    assert [of_rir.white[0] for of_rir in limited] == [0.0] * 4
    assert np.array_equal(limited[0].white[2:], features[0].white[2:]) and limited[0].white[2:].all()


@pytest.mark.parametrize("t60_s, end_s, valid", [(0.6, 0.1, False), (0.6, 0.3, True), (0.08, 0.15, True)])
def test_level_of_which_the_recording_holds_a_part_is_not_valid(t60_s, end_s, valid):
    """The late level needs 200 ms, or a decay that is over before."""
    shares = []
    for seed in range(4):
        rng, t = np.random.default_rng(seed), np.arange(round(end_s * FS_HZ)) / FS_HZ
        rir = np.concatenate([np.zeros(200), rng.standard_normal(len(t)) * 10.0 ** (-3.0 * t / t60_s)])
        rir[200] += 5.0
        features = measure_features(rir)
        shares.append([features.valid[(METRIC == metric) & (BAND_HZ > 400.0)].mean() for metric in ("late", "spectrum")]
                      + [features.valid[METRIC == "drr"].item()])
    shares = np.mean(shares, axis=0)
    assert np.all(shares == 1.0) if valid else np.all(shares < 0.2)


@pytest.mark.parametrize("end_s", [0.1, 0.2, 0.3])
def test_end_of_a_recording_that_is_cut_short_tells_nothing_of_its_noise(end_s):
    """What lies ahead of the direct sound is quieter than the decay at the end, and no noise is missing there."""
    of_noise = np.isin(METRIC, ["floor", "ahead"])
    for seed in range(10):
        rng, t = np.random.default_rng(seed), np.arange(round(end_s * FS_HZ)) / FS_HZ
        rir = np.concatenate([np.zeros(1600), rng.standard_normal(len(t)) * 10.0 ** (-3.0 * t / 0.6)])
        rir[1600] += 5.0
        assert not measure_features(rir + 1e-5 * rng.standard_normal(len(rir))).valid[of_noise].any(), seed


def test_roll_off_and_a_mode_are_no_end_of_the_excitation():
    """A loudspeaker that falls by 24 dB per octave from 60 Hz on in a room whose first mode is at 41 Hz."""
    room = Shoebox((4.2, 3.4, 2.6))
    found_modes, rng = modes(room, 300.0, 343.0), np.random.default_rng(0)
    t60_s = np.full(8, 0.8)
    found = []
    for _ in range(12):
        source, mic = rng.uniform(0.5, np.array(room.dims_m) - 0.5, (2, 3))
        low = modal_response(found_modes, source, mic, damping_per_s(found_modes.frequencies_hz, t60_s), FS_HZ, FS_HZ)
        rir = sosfilt(butter(4, 60.0, "high", fs=FS_HZ, output="sos"), low)
        found.append(excited_from_hz(rir + 4e-4 * np.abs(rir).max() * rng.standard_normal(FS_HZ)))
    assert np.median(found) == 0.0


@pytest.mark.parametrize("colour", [0, 1, 2])  # white, pink, brown
@pytest.mark.parametrize("length_s", [0.7, 1.6])
def test_noise_below_the_octaves_is_no_level(colour, length_s):
    """A loudspeaker that plays nothing below 45 Hz, in noise 60 dB below the direct sound."""
    at = np.flatnonzero((METRIC == "spectrum") & (BAND_HZ > 0) & (BAND_HZ < 45.0))
    frequency_hz = np.maximum(np.fft.rfftfreq(FS_HZ * 2, 1.0 / FS_HZ), 15.0)
    valid = []
    for seed in range(40):
        rir = sosfilt(butter(8, 90.0, "high", fs=FS_HZ, output="sos"), np.pad(response(seed), (0, FS_HZ)))[:2 * FS_HZ]
        rng = np.random.default_rng(1000 + seed)
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * FS_HZ)) / frequency_hz ** (0.5 * colour))
        rir = rir + 5e-3 * noise / noise.std()
        valid.append(measure_features(rir[:round(length_s * FS_HZ)]).valid[at])
    assert np.mean(valid) < 0.05


@pytest.mark.parametrize("order", [0, 2, 4])
def test_loudspeaker_that_falls_by_24_db_per_octave_is_no_end_of_the_excitation(order):
    rirs = [response(seed, from_hz=80.0 if order else None, order=order) for seed in range(9)]
    assert np.median([excited_from_hz(rir) for rir in rirs]) == 0.0


def test_features_below_the_excitation_are_invalid_for_all_rirs_of_a_source():
    features = [measure_features(response(seed, from_hz=110.0)) for seed in range(3)]
    limited = limit_to_excitation([dict(source_id="s", room_id="room")] * 3, features)
    low = (BAND_HZ > 0) & (BAND_HZ < 90.0)
    assert not any(of_rir.valid[low].any() for of_rir in limited)
    kept = (METRIC == "spectrum") & (BAND_HZ > 130.0)
    assert all((of_rir.valid == of_measured.valid)[kept].all() for of_rir, of_measured in zip(limited, features,
                                                                                           strict=True))


def ends(*from_hz, room_ids=None):
    """Return the lowest excited third octave [Hz] of RIRs whose recordings show some lower ends."""
    whole = measure_features(response(0))
    whole = replace(whole, valid=np.ones_like(whole.valid))
    rows = [dict(source_id="s", room_id=room_id) for room_id in room_ids or ["room"] * len(from_hz)]
    limited = limit_to_excitation(rows, [replace(whole, excited_from_hz=hz) for hz in from_hz])
    spectrum = METRIC == "spectrum"
    return [round(float(BAND_HZ[spectrum & of_rir.valid].min())) for of_rir in limited]


def test_end_of_a_sweep_that_every_other_recording_shows_is_the_end():
    assert ends(0.0, 101.0) == ends(101.0, 101.0) == [126, 126]
    assert ends(0.0, 0.0, 101.0, 113.0) == [126] * 4
    assert ends(0.0, 0.0, 101.0) == [25] * 3


def test_end_of_a_sweep_concerns_its_room_alone(caplog):
    with caplog.at_level("INFO"):
        assert ends(0.0, 202.0, 0.0, 202.0, 0.0, room_ids=["a", "b", "a", "b", "a"]) == [25, 251, 25, 251, 25]
    assert "source s: the excitation of 2 of 5 RIRs begins at 202 Hz" in caplog.text


def test_octave_counts_as_excited_if_four_fifths_of_it_are():
    octave = METRIC == "t20"
    assert excited(100.0)[octave].tolist() == [False, True] + [True] * 6
    assert excited(112.0)[octave].tolist() == [False, False] + [True] * 6
    assert excited(0.0).all()
    assert excited(0.0, 5400.0)[octave].tolist() == [True] * 7 + [False]
    assert excited(0.0, 4500.0)[octave].tolist() == [True] * 6 + [False] * 2
    assert excited(0.0, 7700.0)[octave].all()


@pytest.mark.parametrize("normalised", [False, True])
def test_levels_are_comparable_unless_each_rir_was_normalised(normalised):
    distance_m = np.array([1.0, 1.5, 2.0, 3.0, 4.0])
    rirs = [response(seed, amplitude=1.0 / metres) for seed, metres in enumerate(distance_m)]
    if normalised:
        rirs = [rir / np.abs(rir).max() for rir in rirs]
    rows = [dict(room_id="room")] * len(rirs)
    comparable = comparable_levels(rows, [measure_features(rir) for rir in rirs], distance_m)
    assert comparable.tolist() == [not normalised] * len(rirs)


@pytest.mark.parametrize("distance_m", [[1.0, 1.2], [1.0, 3.0], [1.0, 1.5, 2.0]])
@pytest.mark.parametrize("normalised", [False, True])
def test_normalised_rirs_are_recognised_in_rooms_of_two_or_three(distance_m, normalised, caplog):
    rirs = [response(seed, amplitude=1.0 / metres) for seed, metres in enumerate(distance_m)]
    if normalised:
        rirs = [np.round(0.1 * 32768.0 * rir / np.abs(rir).max()) / 32768.0 for rir in rirs]  # in 16 bits
    with caplog.at_level("INFO"):
        comparable = comparable_levels([dict(room_id="room")] * len(rirs), [measure_features(rir) for rir in rirs],
                                       np.array(distance_m))
    assert comparable.tolist() == [not normalised] * len(rirs)
    assert (f"the peaks of its {len(rirs)} RIRs are equal" in caplog.text) == normalised


def test_equal_peaks_at_distances_that_demand_less_than_1_db_tell_nothing():
    features = [measure_features(response(seed) / np.abs(response(seed)).max()) for seed in range(3)]
    assert comparable_levels([dict(room_id="room")] * 3, features, np.array([2.0, 2.1, 2.2])).all()


def test_obstacle_before_near_microphones_is_no_normalisation():
    distance_m = np.array([1.0, 1.5, 2.0, 3.0, 4.0])
    rirs = [response(seed) for seed in range(len(distance_m))]
    for rir, peak in zip(rirs, (6.0, 4.5, 6.5, 4.5, 6.0), strict=True):  # 1.5 dB; the distances demand 4 dB
        rir[195:205] *= peak / np.abs(rir[195:205]).max()
    assert comparable_levels([dict(room_id="room")] * 5, [measure_features(rir) for rir in rirs], distance_m).all()


@pytest.mark.parametrize("sizes, normalised, expected", [
    ((5, 5), (False, False), [True] * 10),
    ((5, 5), (True, False), [False] * 5 + [True] * 5),
    ((3, 3), (True, True), [False] * 6),  # too few in each, and together enough
    ((3, 3), (False, False), [True] * 6),
    ((5, 1), (False, False), [True] * 5 + [False])])  # the last has none to be compared with
def test_levels_are_compared_within_sessions(sizes, normalised, expected):
    """The gain differs by 20 dB between sessions; some are of RIRs that were normalised one by one."""
    rows, rirs, distances_m = [], [], []
    for n, (size, of_session) in enumerate(zip(sizes, normalised, strict=True)):
        for distance_m in (1.0, 1.5, 2.0, 3.0, 4.0)[:size]:
            rir = response(len(rirs), amplitude=1.0 / distance_m)
            rirs.append(0.1 ** n * (rir / np.abs(rir).max() if of_session else rir))
            rows.append(dict(room_id="room", session=f"day {n}"))
            distances_m.append(distance_m)
    comparable = comparable_levels(rows, [measure_features(rir) for rir in rirs], np.array(distances_m))
    assert comparable.tolist() == expected


def test_direct_sound_below_the_noise_is_an_upper_limit():
    rng = np.random.default_rng(0)
    t = np.arange(FS_HZ) / FS_HZ
    rir = np.where(t > 0.03, rng.standard_normal(FS_HZ) * 10.0 ** (-3.0 * t / 0.3), 0.0)
    hidden, audible = (rir + 1e-4 * rng.standard_normal(FS_HZ) for _ in range(2))
    audible[160] += 1.0
    limit, measured = (measure_features(recording, 160.0) for recording in (hidden, audible))
    direct = METRIC == "direct"
    assert limit.bounded.any() and not (limit.bounded & ~CALIBRATION_FEATURES).any()
    assert not limit.valid[direct | (METRIC == "drr")].any()
    assert measured.valid[direct | (METRIC == "drr")].all() and not measured.bounded.any()
    assert np.all(limit.values[limit.bounded] < measured.values[limit.bounded] - 20.0)


def test_end_of_a_decay_that_is_cut_short_is_an_upper_limit_of_noise():
    rir = response(0)[:200 + round(0.3 * FS_HZ)]
    noise = 3e-3 * np.random.default_rng(1).standard_normal(FS_HZ)
    features, noisy = measure_features(rir), measure_features(response(0)[:FS_HZ] + noise)
    floor = METRIC == "floor"
    assert features.bounded[floor].all() and not features.valid[floor].any()
    assert not (noisy.bounded & floor).any() and noisy.valid[floor].all()
    rendered = measure_features(rir, 200.0, white=features.white)  # which has the same decay at its end
    assert np.allclose(features.values[floor], rendered.values[floor], atol=0.1)


def test_hum_at_a_low_frequency_is_no_noise_at_others():
    rir = response(0)
    hum = 0.05 * np.sin(2.0 * np.pi * 58.0 * np.arange(len(rir)) / FS_HZ + 0.5)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(rir))
    change = measure_features(rir + noise + hum).values - measure_features(rir + noise).values
    floor = METRIC == "floor"
    assert change[floor & (np.abs(BAND_HZ - 63.0) < 5.0)] > 20.0
    assert np.abs(change[floor & (BAND_HZ > 110.0)]).max() < 4.0
    assert np.abs(change[floor & (BAND_HZ > 180.0)]).max() < 0.5


def test_upper_limit_counts_where_the_prediction_exceeds_it():
    values, valid, bounded = np.zeros((1, 3)), np.array([[True, False, False]]), np.array([[False, True, True]])
    data = SimpleNamespace(features=values, valid=valid, bounded=bounded)
    residual, counts = Data.residual(data, np.array([[2.0, 3.0, -3.0]]))
    assert counts.tolist() == [[True, True, False]] and residual[0, :2].tolist() == [-2.0, -3.0]


def test_equal_distances_do_not_tell_whether_levels_are_comparable():
    features = [measure_features(response(seed)) for seed in range(5)]
    assert comparable_levels([dict(room_id="room")] * 5, features, np.full(5, 2.0)).all()


def test_white_noise_is_bounded_by_octaves_that_end_in_their_decay():
    """Low octaves decay fast and show hum; the response is cut before the others reach any noise."""
    rng = np.random.default_rng(0)
    t = np.arange(FS_HZ) / FS_HZ
    hum = 0.02 * np.sin(2.0 * np.pi * 60.0 * t)
    whole = np.concatenate([np.zeros(200), rng.standard_normal(FS_HZ) * 10.0 ** (-3.0 * t / 1.2) + hum])
    whole[200] += 20.0
    white = measure_features(whole).white
    assert 10.0 * np.log10(white.max() + 1e-12) < -40.0


def test_spectrum_shows_a_mode_below_the_lowest_octave():
    """A mode at 31.6 Hz raises the level of its third octave, which begins below the octaves, and nothing else."""
    rir = response(0)
    t = np.arange(len(rir) - 200) / FS_HZ
    with_mode = rir.copy()
    with_mode[200:] += 0.5 * np.sin(2.0 * np.pi * 31.62 * t) * 10.0 ** (-3.0 * t / 0.5)
    change = measure_features(with_mode).values - measure_features(rir).values
    spectrum, at_mode = METRIC == "spectrum", np.abs(BAND_HZ - 31.62) < 1.0
    assert change[spectrum & at_mode] > 6.0
    assert np.abs(change[spectrum & (BAND_HZ > 60.0)]).max() < 1.5
    assert BAND_HZ[spectrum].min() == pytest.approx(25.1, abs=0.1)
