"""The closed loop on small generated rooms: it adds nothing to clean rooms, and the effect where there is one."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from rirmaker import DIRECT, coloured_rir
from scipy.optimize import brentq
from scipy.special import polygamma

from roomeq.acoustics.iso3382 import EARLY_S
from roomeq.acoustics.octaves import OCTAVE_WIDTH_HZ, octave_bands
from roomeq.cli import main
from roomeq.core.audio import write_wav
from roomeq.core.constants import FS_HZ
from roomeq.core.files import read_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.coupled_volume import CoupledVolume
from roomeq.effects.model import read_model
from roomeq.effects.occlusion import Occlusion
from roomeq.effects.response import RESPONSE_HZ
from roomeq.effects.sound_speed import SoundSpeed
from roomeq.effects.source_directivity import SourceDirectivity, unit_facing
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import power, splitters
from roomeq.loop.ceiling import ceiling_errors, twin_recordings
from roomeq.loop.close import SCATTERING
from roomeq.loop.data import load_data
from roomeq.loop.facing import with_estimated_facings, with_facings
from roomeq.loop.features import (
    CALIBRATION_FEATURES,
    HAS_GAIN,
    JND,
    LATE_S,
    METRIC,
    feature_slice,
    measure_features,
    with_noise_in_octaves,
)
from roomeq.loop.fit import fit
from roomeq.loop.heldout_errors import (
    _USABLE,
    SPLITS,
    heldout_errors,
    p_with_other_devices,
    predicted_errors,
    transferred,
)
from roomeq.loop.ledger import _parameter_intervals
from roomeq.loop.likelihood import misfit, normal_equations
from roomeq.loop.packing import N_SURFACE, Linearization, ParameterIndex
from roomeq.loop.power import _changes, detectable_sizes
from roomeq.loop.predict import ReflectedEnergy, predict
from roomeq.loop.ray_energy import sum_rays
from roomeq.loop.refined_facing import _turned, refined_facings
from roomeq.loop.rendering import render_rows, rendered_features, row_models
from roomeq.loop.selection import _candidate, _densities, choose, rank, size_of_change_jnd
from roomeq.loop.session import effects_lacking, fit_base_model
from roomeq.loop.splitters import (
    COMMON_SPECTRUM,
    calibrate,
    leave_rooms_out,
    rooms_by_devices,
    split_positions,
    transfer_shared,
)
from roomeq.loop.step import close_loop
from roomeq.loop.tables import ANGLES
from roomeq.loop.usable import usable_rirs
from roomeq.records.rir_dir import load_rir, read_rirs, relocated, write_rirs
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Air, Material, Scene, Shoebox
from roomeq.validate import validate
from testbed import make_room_set

ROOMS = 5
SEED = 3


@pytest.fixture(scope="module")
def room_set(tmp_path_factory):
    """Make generated rooms by kind of effect; all kinds share their five rooms."""
    cache = tmp_path_factory.mktemp("cache")
    made = {}

    def make(kind, strength=4):
        if kind not in made:
            made[kind] = tmp_path_factory.mktemp("rooms") / "set"
            make_room_set(kind, strength, SEED, made[kind], n_fit=ROOMS, n_judge=1, cache=cache)
        return made[kind]
    return make


@pytest.fixture(scope="module")
def closed(room_set, tmp_path_factory):
    """Close the loop on generated rooms; return its directory and ledger."""
    made = {}

    def close(kind):
        if kind not in made:
            out = tmp_path_factory.mktemp("loop") / "loop"
            close_loop([room_set(kind) / "fit"], out, test=[room_set(kind) / "test"], nj=2)
            made[kind] = out
        return made[kind], read_json(made[kind] / "ledger.json")
    return close


COMPILES = """import gc, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from roomeq import compile_kernels
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.loop.data import load_data
from roomeq.loop.fit import fit
from roomeq.loop.session import fit_base_model
from roomeq.loop.usable import usable_rirs

def compiled():
    kernels = [kernel for kernel in gc.get_objects() if isinstance(kernel, Dispatcher)]
    return {(kernel.py_func.__qualname__, str(types)) for kernel in kernels if kernel.__module__.startswith("roomeq")
            for types in kernel.overloads}

for part in (compile_kernels.analyse, compile_kernels.simulate, compile_kernels.predict):
    part()
before = compiled()
session = fit_base_model(load_data(usable_rirs([Path(sys.argv[1])]), scattering=0.3, seed=0), seed=0, nj=1)
fit(session.data, session.correction, [SourceDirectivity])
missing = compiled() - before
sys.exit(f"{len(before)} were compiled, and not {missing}" if missing or not before else 0)
"""


def data_of(directory):
    return load_data(usable_rirs([directory]), scattering=SCATTERING, seed=0)


@pytest.fixture(scope="module")
def session(room_set):
    """Fit the base model to clean rooms."""
    data = data_of(room_set("clean") / "fit")
    return fit_base_model(data, seed=0, nj=2, measured=effects_lacking(data))


def test_installation_has_compiled_what_the_loop_needs(room_set):
    done = subprocess.run([sys.executable, "-c", COMPILES, room_set("source_directivity") / "fit"],
                          check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_predicted_errors_are_about_those_of_renderings_and_the_same_for_any_number_of_jobs(session):
    predicted, rendered = predicted_errors(session), heldout_errors(session)
    alone = predicted_errors(replace(session, nj=1))
    for split in SPLITS:
        values = predicted.by_split[split]
        assert values.tobytes() == alone.by_split[split].tobytes()
        assert np.array_equal(np.isfinite(values), np.isfinite(rendered.by_split[split]))
        assert predicted.mean(split) == pytest.approx(rendered.mean(split), rel=0.1)


def test_each_room_is_predicted_with_its_own_vectors(session):
    effects = [effect for effect in CATALOGUE.values() if not effect.INTERPOLATION_GRID]
    data, rng = session.data, np.random.default_rng(0)
    index, absorption = ParameterIndex(data, effects), session.index.absorption(session.fit.mean, session.fit.local)
    vectors = [[np.array(effect.STARTS[0]) + 0.1 * rng.standard_normal((len(data.units(effect.SCOPE)[0]),
                                                                       len(effect.SPREAD))) for effect in effects]
               for _ in data.room_names]
    found = index.predict_rooms(absorption, vectors)
    for room, of_room in enumerate(vectors):
        members = data.room == room
        assert np.array_equal(found[members], predict(data, index.state(absorption, of_room))[members])


def test_parameters_of_unseen_rooms_converge(session, room_set, monkeypatch, caplog):
    data = data_of(room_set("source_response") / "test")
    _, calibrated = transferred(data, session)
    first, _ = split_positions(data)
    absorption, _, gains = calibrated(first, _USABLE["leave_room_out"])
    monkeypatch.setattr(splitters, "_MOST_ITERATIONS", 200)
    of_more, _, gains_of_more = calibrated(first, _USABLE["leave_room_out"])
    np.testing.assert_allclose(absorption, of_more, rtol=0.02)
    np.testing.assert_allclose(gains, gains_of_more, atol=0.1)
    assert "did not converge" not in caplog.text
    monkeypatch.setattr(splitters, "_MOST_ITERATIONS", 2)
    calibrated(first, _USABLE["leave_room_out"])
    assert "did not converge in 2 iterations" in caplog.text


def test_direct_sound_tells_nothing_about_the_surfaces_of_unseen_rooms(session, room_set):
    known, _ = split_positions(session.data)
    held_out = leave_rooms_out(session.data, session.fit)
    test = data_of(room_set("source_response") / "test")
    known_of_test, _ = split_positions(test)
    calibrations = []
    for error_db in (0.0, 5.0):
        def disturbed(data, error_db=error_db):
            error = error_db * np.random.default_rng(0).standard_normal(data.features.shape)
            return replace(data, features=data.features + np.where(METRIC == "direct", error, 0.0))

        of_own = calibrate(replace(session, data=disturbed(session.data)), held_out, known, _USABLE["leave_room_out"])
        _, calibrated = transferred(disturbed(test), session)
        of_test, _, gains = calibrated(known_of_test, _USABLE["leave_room_out"])
        calibrations.append((of_own.absorption, of_test, of_own.gains, gains))
    (own, of_test, *gains), (own_disturbed, of_disturbed, *gains_disturbed) = calibrations
    np.testing.assert_array_equal(own_disturbed, own)
    np.testing.assert_allclose(of_disturbed, of_test, rtol=0.01)
    assert all(np.abs(a - b).max() > 0.1 for a, b in zip(gains, gains_disturbed, strict=True))


def test_rirs_of_a_source_are_rendered_in_their_own_air(tmp_path):
    room, source = Shoebox((8.0, 6.0, 3.5)), (2.0, 2.0, 1.5)
    rows = []
    for celsius in (5.0, 35.0):
        scene = Scene(room, [Material("wall", 0.1, 0.3)] * 6, Air(celsius, 30.0))
        for n, mic_m in enumerate(((6.5, 4.5, 1.3), (6.0, 3.0, 1.6))):
            (response,) = simulate_responses(scene, source, mic_m, num_rays=2000)
            name = f"t{celsius:02.0f}-{n}"
            write_wav(tmp_path / f"{name}.wav", response.rir)
            rows.append(dict(id=name, wav=f"{name}.wav", room_id="r", room_dims_m=[8.0, 6.0, 3.5], source_id="s",
                             mic_id=f"m{n}", source_pos_m=list(source), mic_pos_m=list(mic_m), fs_hz=16000,
                             n_samples=len(response.rir), temperature_c=celsius, humidity_pct=30.0, tof_removed=False))
    write_rirs(tmp_path, rows)
    data = data_of(tmp_path)
    absorption = np.full((1, 2, 8), 0.1)
    rendered = rendered_features(data, row_models(data, absorption, [[]] * len(data.rows)), seed=0)
    predicted = ParameterIndex(data, ()).predict(absorption, [], np.zeros(len(data.rows)), 0.0)
    at = METRIC == "arrival"
    np.testing.assert_allclose(rendered[:, at], predicted[:, at], atol=0.3)
    np.testing.assert_allclose(rendered[:, at], data.features[:, at], atol=0.3)


def test_features_are_in_just_noticeable_differences(room_set):
    directory = room_set("clean") / "fit"
    rir = load_rir(directory, read_rirs(directory)[0])
    plain, louder = measure_features(rir), measure_features(10.0 ** 0.15 * rir)
    change = np.where(plain.valid, louder.values - plain.values, np.nan)
    np.testing.assert_allclose(change[HAS_GAIN & plain.valid], 3.0, atol=1e-6)
    assert np.nanmax(np.abs(change[~HAS_GAIN & (METRIC != "floor") & (METRIC != "ahead")])) < 1e-6
    rirs = ([coloured_rir(seed, time_s=time_s, length_s=1.2) for seed in range(4)] for time_s in (0.4, 0.42))
    short, long = (np.mean([measure_features(rir).values[feature_slice("t20")][3:] for rir in of_time])
                   for of_time in rirs)
    assert long - short == pytest.approx(1.0, abs=0.2)


def test_noise_is_scored_relative_to_white_noise_and_a_floor():
    """White noise of any level scores about 0; a rise of the lowest octave scores in dB, and goes to 0 smoothly."""
    rir = coloured_rir(1, time_s=0.4, length_s=1.2)

    def floor(noise, **more):
        measured = measure_features(rir + noise, **more)
        values = with_noise_in_octaves(measured.values)
        return values[feature_slice("floor")], measured.valid[feature_slice("floor")], measured.white
    rises, rendered = [], []
    for seed in range(12):  # the noise of a few periods scatters
        rng = np.random.default_rng(seed)
        white = 1e-3 * rng.standard_normal(len(rir))
        low = octave_bands(1e-3 * rng.standard_normal(len(rir)), FS_HZ)[0]
        for level in (0.1, 1.0, 4.0) if seed == 0 else ():
            values, valid, _ = floor(level * white)
            assert valid.all() and np.abs(values[9:]).max() < 1.5 and np.abs(values).max() < 4.0
        rises.append([floor(white + gain * low)[0][0] for gain in (0.0, 0.7, 1.5, 3.0)])
        # a rendering has no white noise: that of the recording is assumed
        known = floor(white)[2]
        rendered.append([floor(gain * low, white=known)[0][0] for gain in (3.0, 10.0)])
        assert np.abs(floor(0.0 * low, white=known)[0]).max() < 1e-3
    rises, rendered = np.mean(rises, axis=0), np.mean(rendered, axis=0)
    assert np.all(np.diff(rises) > 0.5) and rises[1] < 5.0 and rises[3] == pytest.approx(9.5, abs=2.0)
    assert rendered == pytest.approx([rises[3], rises[3] + 20.0 * np.log10(10.0 / 3.0)], abs=2.0)


def test_noise_of_a_truncated_response_is_valid_only_if_its_end_is_quiet():
    long, short = (coloured_rir(1, time_s=time_s, length_s=0.6) for time_s in (1.5, 0.3))
    floor = feature_slice("floor")
    assert not measure_features(long).valid[floor][6:].any()  # the lowest octaves are too narrow to follow a decay
    quiet = measure_features(short)
    assert quiet.valid[floor].all() and np.abs(quiet.values[floor]).max() < 1e-3


def test_ahead_of_an_earlier_rendering_is_finite_where_it_is_valid():
    rir = coloured_rir(1, time_s=0.3, length_s=0.6)
    recording, rendering = (measure_features(rir[DIRECT - sample:]) for sample in (113, 93))
    valid_ahead = recording.valid[feature_slice("ahead")]
    assert valid_ahead.any() and not rendering.valid[feature_slice("ahead")].any()
    assert np.isfinite(rendering.values[feature_slice("ahead")][valid_ahead]).all()


@pytest.mark.parametrize("late_samples, arrives", [(3, True), (28, False)])
def test_sound_too_late_for_the_direct_sound_is_another_path(late_samples, arrives):
    expected, rir = DIRECT, coloured_rir(1, time_s=0.3, length_s=0.6)
    rir[:expected + late_samples] = 0.0
    rir[expected + late_samples] = 1.0
    measured = measure_features(rir, expected)
    assert measured.valid[feature_slice("arrival")].all() == arrives
    assert measured.direct_sample == pytest.approx(expected + late_samples * arrives, abs=0.5)


def test_own_predictions_as_measurements_leave_no_error_and_no_effect(session):
    """Only the priors leave an error, and no effect helps."""
    itself = replace(session.data, features=session.fit.predicted)
    again = fit(itself, session.correction, (), initial=session.fit)
    error = np.abs(itself.features - again.predicted)[itself.valid]
    assert error.mean() < 0.02 and error.max() < 0.5
    winner, _ = choose(rank(replace(session, data=itself, fit=again)), len(CATALOGUE))
    assert winner is None


def test_error_of_clean_rooms_is_that_of_the_ceiling(session):
    """The rooms come from another simulator, so that the ceiling has to predict what a right model reaches there."""
    errors, ceiling = heldout_errors(session), ceiling_errors(session)
    for split in SPLITS:
        assert 0.75 < ceiling.mean(split) / errors.mean(split) < 1.15
        of_metric, least = errors.by_metric(split), ceiling.by_metric(split)
        assert max(abs(of_metric[metric] - least[metric]) for metric in of_metric) < 1.0
    again = ceiling_errors(session)
    assert all(np.array_equal(again.by_split[split], ceiling.by_split[split], equal_nan=True) for split in SPLITS)


def test_twin_recordings_scatter_like_diffuse_sound(session):
    """Scatter of T20 (ISO 3382-2:2008, sec. 7.1; ten decays for an integrated response) and of late levels."""
    data, index, fitted = session.data, session.index, session.fit
    absorption, gains = index.absorption(fitted.mean, fitted.local), index.gains(fitted.local)
    first, second = (twin_recordings(data, absorption, session.by_row, gains, seed=seed, nj=2) for seed in (1, 2))
    difference = np.abs(first.features - second.features)
    time_s = np.exp(first.features[:, feature_slice("t20")] * JND["t20"])
    tau_s, gate_s = time_s / (6.0 * np.log(10.0)), LATE_S - EARLY_S
    effective_s = 2.0 * tau_s * np.tanh(0.5 * gate_s / tau_s)  # of an exponential decay
    scatter = dict(t20=0.88 * np.sqrt((1.0 + 1.90 / 10.0) / (OCTAVE_WIDTH_HZ * time_s)) / JND["t20"],
                   late=10.0 / np.log(10.0) * np.sqrt(polygamma(1, OCTAVE_WIDTH_HZ * effective_s)))
    for metric, expected in scatter.items():
        at = feature_slice(metric)
        valid = first.valid[:, at] & second.valid[:, at]
        ratio = difference[:, at][valid].mean() / (2.0 / np.sqrt(np.pi) * expected[valid]).mean()
        assert ratio == pytest.approx(1.0, abs=0.25)


def test_interval_of_a_loudspeaker_of_one_room_comes_from_that_room(session):
    data = session.data
    rows = [{**row, "source_id": f"of {row['room_id']}"} for row in data.rows]
    data = replace(data, rows=rows)
    fitted = fit(data, session.correction, (SourceResponse,), initial=session.fit)
    intervals = _parameter_intervals(replace(session, data=data, effects=fitted.effects, fit=fitted), SourceResponse)
    assert len(intervals) == len(data.room_names)
    half, best = (np.array([f(unit) for unit in intervals.values()]) for f in (
        lambda unit: 0.5 * np.subtract(unit["high"]["gains_db"], unit["low"]["gains_db"]),
        lambda unit: unit["best"]["gains_db"]))
    assert half.min() > 0.1
    # a jackknife without its only room would leave the prior, and a half that is proportional to the estimate
    assert np.corrcoef(half.ravel(), np.abs(best).ravel())[0, 1] < 0.9


@pytest.mark.parametrize("effect", [SourceResponse, SoundSpeed, CoupledVolume])
def test_effect_is_found_above_its_stated_size_and_not_far_below(effect, session, monkeypatch):
    """A pattern of the effect is added to the features of recordings that follow the model, at 2 and at 0.4 times its
    stated size."""
    index, fitted = session.index, session.fit
    clean_data = twin_recordings(session.data, index.absorption(fitted.mean, fitted.local),
                                 session.by_row, index.gains(fitted.local), seed=3, nj=2)

    def candidate_with(added):
        data = replace(clean_data, features=clean_data.features + added)
        fitted = fit(data, session.correction, (), initial=session.fit)
        return _candidate(replace(session, data=data, fit=fitted), effect, fitted, _densities(data, fitted))

    clean = candidate_with(0.0)
    change = _changes(session, effect)[0]
    monkeypatch.setattr(power, "_changes", lambda *_: [change])  # not the median of several patterns
    (stated_jnd,) = detectable_sizes(session, [clean], [])
    refused = replace(clean, size_jnd=stated_jnd + 1.0)  # its rendered error did not fall
    assert detectable_sizes(session, [refused], [clean.effect]) == [stated_jnd + 1.0]
    beyond_max_effects = replace(refused, gain=np.full(len(clean.gain), 10.0))
    assert detectable_sizes(session, [beyond_max_effects], []) == [stated_jnd + 1.0]
    for factor in (2.0, 0.4):
        scale = brentq(lambda x: size_of_change_jnd(clean_data, x * change) - factor * stated_jnd, 0.0, 1e3)  # noqa: B023
        assert candidate_with(scale * change).helps(1) == (factor > 1.0)
    assert not clean.helps(1)


def test_effect_that_fits_one_room_says_nothing_for_the_others(session):
    """One room, whose rows may be wrong, makes the features scatter in the base model, which all rooms share."""
    index, fitted, of_first = ParameterIndex(session.data, [Occlusion]), session.fit, session.data.room == 0
    absorption = session.index.absorption(fitted.mean, fitted.local)
    free, obstructed = (index.predict(absorption, [np.log(np.where(of_first, metres, 1e-4))[:, None]])
                        for metres in (1e-4, 0.3))
    data = replace(session.data, features=session.data.features + obstructed - free)
    base = fit(data, session.correction, (), initial=fitted)
    gain = _candidate(replace(session, data=data, fit=base), Occlusion, base, _densities(data, base)).gain
    assert gain[0] > 10.0 and np.all(gain[1:] < 3.0)


def test_leaving_a_room_out_changes_the_shared_parameters_a_little(session):
    held_out = leave_rooms_out(session.data, session.fit)
    assert len(held_out) == ROOMS
    for room in held_out:
        assert np.isfinite(room.log_density)
        assert 0.0 < np.abs(room.mean - session.fit.mean).max() < 1.0


def test_obstacles_of_held_out_rirs_are_found_from_half_of_their_direct_sound(session):
    """Some RIRs are behind an obstacle, and some behind one that leaves nothing of the direct sound but a limit."""
    index, fitted, n_rirs = ParameterIndex(session.data, [Occlusion]), session.fit, len(session.data.rows)
    absorption, gains = session.index.absorption(fitted.mean, fitted.local), session.index.gains(fitted.local)
    detour_m = np.random.default_rng(0).choice([1e-3, 0.3, 1.2], n_rirs, p=[0.5, 0.25, 0.25])
    features, free = (index.predict(absorption, [np.log(metres)[:, None]], gains, session.correction)
                      for metres in (detour_m, np.full(n_rirs, 1e-4)))
    hidden = (detour_m > 1.0)[:, None]
    bounded = hidden & CALIBRATION_FEATURES
    data = replace(session.data, features=np.where(bounded, free - 30.0, features), bounded=bounded,
                   valid=session.data.valid & ~(hidden & np.isin(METRIC, ["direct", "drr", "arrival"])))
    with_obstacles = fit(data, session.correction, [Occlusion], initial=fitted)
    obstructed = replace(session, data=data, effects=(Occlusion,), fit=with_obstacles)
    known, scored = split_positions(data)
    vectors = calibrate(obstructed, leave_rooms_out(data, with_obstacles), known).vectors
    for of_room, rirs in zip(vectors, scored, strict=True):
        found_m = np.exp(of_room[0][rirs, 0])
        assert np.all((0.15 < found_m) == (detour_m[rirs] > 0.15))
        assert np.all(found_m[detour_m[rirs] > 1.0] > 0.8)


def test_spectrum_of_unseen_rooms_lies_between_the_known_ones_and_rooms_in_general(session):
    x = transfer_shared(session, session.index).mean[:8]
    of_session = session.fit.mean[:8] - session.fit.mean[4]
    low, high = np.minimum(of_session, COMMON_SPECTRUM), np.maximum(of_session, COMMON_SPECTRUM)
    assert np.all((low - 1e-9 <= x - x[4]) & (x - x[4] <= high + 1e-9)) and x[4] == session.fit.mean[4]


def test_rows_rendered_together_are_those_rendered_alone(session):
    data, members = session.data, np.flatnonzero(session.data.room == 0)
    models = row_models(data, np.full((len(data.room_names), 2, 8), 0.2), [[]] * len(data.rows), members)
    raw_rirs, features = render_rows(data, models, seed=0)
    assert len(models) > 1
    for model, raw, of_row in zip(models, raw_rirs, features, strict=True):
        (alone,), alone_features = render_rows(data, [model], seed=0)
        assert raw.rir.tobytes() == alone.rir.tobytes()
        np.testing.assert_array_equal(of_row, alone_features[0])


def test_halves_are_disjoint_and_hold_every_chain(session):
    first, second = split_positions(session.data)
    for r, (a, b) in enumerate(zip(first, second, strict=True)):
        assert not set(a) & set(b) and set(a) | set(b) == set(np.flatnonzero(session.data.room == r))
        assert set(session.data.chain[a]) == set(session.data.chain[b])


def test_slopes_of_separate_bands_taken_together_are_those_of_each(session):
    data, index, fitted = session.data, session.index, session.fit
    centre, derivatives = index.linearize(fitted.mean, fitted.local, session.correction)
    gains = np.outer(index.gains(fitted.local), HAS_GAIN)
    state = index.state(index.absorption(fitted.mean, fitted.local), [])
    rays = sum_rays(data, state, by_absorption=True)
    for n in range(N_SURFACE):
        mean, step = fitted.mean.copy(), 1e-4
        mean[n] += step
        moved = index.state(index.absorption(mean, fitted.local), [])
        slopes = (predict(data, moved, ReflectedEnergy(data, moved, rays)) + gains + session.correction - centre) / step
        np.testing.assert_allclose(derivatives.by_surface[:, :, n], slopes, rtol=0.02, atol=0.02)
    assert np.ptp(derivatives.by_surface[:, METRIC == "drr"]) > 0.1 and len(data.rows) > 8


def test_energy_of_rays_at_another_absorption_and_directivity_is_that_of_another_sum(session):
    data, index, fitted = session.data, session.index, session.fit
    state = index.state(index.absorption(fitted.mean, fitted.local), [])
    whole = sum_rays(data, state).energy
    rays = sum_rays(data, state, by_absorption=True, by_angle=True)
    np.testing.assert_array_equal(rays.energy, whole)
    assert rays.at(state) is rays.energy
    for surfaces in (0, 1):
        below, above = (replace(state, absorption=state.absorption * np.where(
            np.arange(2) == surfaces, 1.0 + sign * 2e-3, 1.0)[:, None]) for sign in (-1.0, 1.0))
        change = sum_rays(data, above).energy - sum_rays(data, below).energy
        assert np.all(change <= 0.0) and np.abs(change).max() > 1e-4 * whole.max()
        np.testing.assert_allclose(rays.at(above) - rays.at(below), change, rtol=0.02, atol=1e-6 * whole.max())
    gain = np.random.default_rng(0).uniform(0.0, 2.0, (len(data.rows), len(ANGLES), 8))
    directive, turned_away = replace(state, ray_gain=gain), replace(state, ray_gain=0.5 * gain)
    of_directive = sum_rays(data, directive, by_angle=True)
    assert np.abs(of_directive.energy / np.maximum(whole, 1e-30) - 1.0).max() > 0.2
    for one in (rays, of_directive):
        np.testing.assert_allclose(one.at(directive), of_directive.energy, rtol=1e-4, atol=1e-6 * whole.max())
        np.testing.assert_allclose(one.at(turned_away), 0.5 * of_directive.energy, rtol=1e-4, atol=1e-6 * whole.max())
    for other in (above, directive):
        with pytest.raises(ValueError, match="not summed"):
            sum_rays(data, state).at(other)


@pytest.mark.parametrize("order", [("source_response", "source_directivity"), ("source_directivity", "noise_floor")])
def test_derivatives_by_an_effect_have_all_other_effects(session, order):
    effects = tuple(CATALOGUE[name] for name in order)
    fitted = fit(session.data, session.correction, effects, initial=session.fit, iterations=1)
    index, part = ParameterIndex(session.data, effects), 0.003
    centre, derivatives = index.linearize(fitted.mean, fitted.local, session.correction)
    for k, effect in enumerate(effects):
        absorption, vectors = (of(fitted.mean, fitted.local) for of in (index.absorption, index.vectors))
        step = part * effect.SPREAD[0]
        vectors[k] = vectors[k].copy()
        vectors[k][:, 0] += step
        moved = index.predict(absorption, vectors, index.gains(fitted.local), session.correction)
        slopes = derivatives.by_effect[effect][:, :, 0]
        np.testing.assert_allclose(slopes, (moved - centre) / step, rtol=0.02, atol=0.02)


def test_rooms_of_a_group_are_left_out_together(session):
    data, fitted = session.data, session.fit
    alone, same, together = (leave_rooms_out(data, fitted, groups) for groups in (
        None, np.arange(len(data.room_names)), np.zeros(len(data.room_names), dtype=int)))
    for a, b, c in zip(alone, same, together, strict=True):
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_allclose(c.mean, together[0].mean, atol=1e-6)  # nothing is known of any room
        assert np.linalg.norm(c.precision) < 0.5 * np.linalg.norm(a.precision)


def test_equaliser_needs_rooms_with_other_devices(session):
    weights = np.ones(session.data.features.shape)
    rows = [{**row, "source_id": row["room_id"], "mic_id": row["room_id"]} for row in session.data.rows]
    apart = replace(session, data=replace(session.data, rows=rows))
    assert len(set(rooms_by_devices(session.data))) == 1 and len(set(rooms_by_devices(apart.data))) > 2
    assert p_with_other_devices(session, session, weights) == 1.0


def test_derivatives_are_kept_while_features_hardly_change(session):
    index, fitted = session.index, session.fit
    linearization = Linearization(index, session.correction)
    _, first = linearization.at(fitted.mean, fitted.local)
    near, far = fitted.mean + 1e-4, fitted.mean + 0.3
    predicted, kept = linearization.at(near, fitted.local)
    assert kept is first
    np.testing.assert_array_equal(predicted, index.linearize(near, fitted.local, session.correction)[0])
    exact = linearization.at(near, fitted.local, same_jnd=0.0)[1]
    assert exact is not first and linearization.at(near, fitted.local, same_jnd=0.0)[1] is exact
    assert linearization.at(far, fitted.local)[1] is not exact


def test_a_copy_of_reflected_energy_is_for_another_state(session):
    data, index, fitted = session.data, session.index, session.fit
    state = index.state(index.absorption(fitted.mean, fitted.local), index.vectors(fitted.mean, fitted.local))
    one = ReflectedEnergy(data, state)
    direct = np.ones((len(data.rows), 8))
    of_one = one.decay_times_s(direct, None)
    before, twin = of_one.copy(), one.copy()
    assert np.any(twin.decay_times_s(1e6 * direct, None) < 0.5 * before)
    np.testing.assert_array_equal(of_one, before)
    np.testing.assert_array_equal(one.decay_times_s(direct, None), before)


def test_steps_of_a_fit_go_downhill(session):
    """The gradient of the normal equations is that of the cost, also where large residuals count linearly."""
    index, fitted = session.index, session.fit
    predicted, derivatives = index.linearize(fitted.mean, fitted.local, session.correction)
    far = np.random.default_rng(0).standard_t(1.5, predicted.shape) * 3.0
    residual, valid = session.data.residual(predicted + far)
    for r, members in enumerate(index.members):
        equations = normal_equations(index, r, residual, valid, derivatives, fitted.sigma, fitted.omega)
        direction = np.linalg.solve(equations.own_own + np.eye(len(equations.own_own)), equations.own_residual)
        values = np.concatenate([part[rows] for part, rows in index.room_derivatives(r, derivatives)], axis=2)
        places = np.concatenate(index.room_places(r), axis=1)
        by_place = np.zeros(places.max() + 1)
        np.add.at(by_place, index.own_place[r], 1e-4 * direction)
        moved = residual[members] - np.einsum("ifn,in->if", values, by_place[places])
        before, after = (misfit(part, valid[members], fitted.sigma, fitted.omega) for part in (residual[members],
                                                                                              moved))
        assert (after - before) / 1e-4 == pytest.approx(-2.0 * equations.own_residual @ direction, rel=0.02)


def without_stated_facings(source, directory):
    """Return the data of RIRs whose rows do not state where sources face."""
    directory.mkdir()
    write_rirs(directory, [row | dict(source_dir=None) for row in relocated(read_rirs(source), source, directory)])
    return data_of(directory)


def with_facings_that_no_row_states(source, directory):
    """Return the base model of RIRs whose facings are estimated."""
    return with_estimated_facings(fit_base_model(without_stated_facings(source, directory), seed=0, nj=2))


def test_unstated_facing_is_estimated(room_set, tmp_path):
    source = room_set("source_directivity") / "fit"
    true = {row["id"]: np.array(row["source_dir"]) for row in read_rirs(source)}
    session = with_facings_that_no_row_states(source, tmp_path / "unstated")
    assert {facing.hypothesis for facing in session.data.facings} <= {"fixed", "free"}
    angles = []
    for row, place in zip(session.data.rows, session.data.places, strict=True):
        towards = np.subtract(place.mic_pos_m, place.source_pos_m)
        towards /= np.linalg.norm(towards)
        angles.append([np.degrees(np.arccos(np.clip(towards @ axis, -1.0, 1.0)))
                       for axis in (true[row["id"]], row["source_dir"])])
    assert np.corrcoef(np.transpose(angles))[0, 1] > 0.8
    assert np.median(np.abs(np.diff(angles))) < 20.0


def test_loudspeakers_that_radiate_alike_in_all_directions_have_no_facing(room_set, tmp_path):
    session = with_facings_that_no_row_states(room_set("clean") / "fit", tmp_path / "unstated")
    assert {facing.hypothesis for facing in session.data.facings} == {"towards the microphone"}


def test_axes_are_refined_together_with_the_directivity(room_set, tmp_path):
    """Axes that are turned, one way in each room, are found, although the directivity was fitted to them."""
    source = room_set("source_directivity") / "fit"
    true = {row["id"]: unit_facing(row["source_dir"]) for row in read_rirs(source)}
    data = without_stated_facings(source, tmp_path / "unstated")
    turns_rad = np.radians([12.0, -12.0, -12.0, 12.0, 12.0])
    wrong = {n: _turned(true[row["id"]], turns_rad[data.room[n]]) for n, row in enumerate(data.rows)}
    base = fit_base_model(replace(with_facings(data, wrong), axis=data.room), seed=0, nj=2)
    fitted = fit(base.data, base.correction, (SourceDirectivity,))
    refined = refined_facings(replace(base, effects=fitted.effects, fit=fitted))
    before_deg, after_deg = ([np.degrees(np.arccos(np.clip(true[row["id"]] @ row["source_dir"], -1.0, 1.0)))
                              for row in turned.rows] for turned in (base.data, refined))
    assert np.median(before_deg) > 10.0 and np.max(after_deg) < 4.0


def test_gains_of_chains_with_a_single_rir_are_sums(session):
    """A chain of several RIRs has its own gain; else the gain is a sum over room, source and microphone."""
    data = session.data
    assert all((kinds == 0).all() and (parts.sum(axis=1) == 1).all()
               for parts, kinds in zip(session.index.gain_design, session.index.gain_kind, strict=True))
    members = np.flatnonzero(data.room == 0)[:4]
    changed = list(data.rows)
    for k, n in enumerate(members):
        changed[n] = changed[n] | dict(source_id=f"s{k // 2}", mic_id=f"m{k % 2}")
    chain = data.chain.copy()
    chain[members] = data.chain.max() + 1 + np.arange(4)
    index = ParameterIndex(replace(data, rows=changed, chain=chain), ())
    parts, kinds = index.gain_design[0], index.gain_kind[0]
    assert sorted(kinds[parts[:4].any(axis=0)]) == [0, 1, 1, 2, 2]
    gains_db = np.array([10.0, 1.0, -1.0, 0.5, -0.5])
    local = [np.zeros(size) for _, size in index.local]
    local[0][N_SURFACE + np.flatnonzero(parts[:4].any(axis=0))] = gains_db
    np.testing.assert_allclose(index.gains(local)[members], [11.5, 10.5, 9.5, 8.5])
    first, second = split_positions(index.data)
    assert {len(set(half[0]) & set(members)) for half in (first, second)} == {2}
    for half in (first, second):
        here = [changed[n] for n in half[0] if n in members]
        assert {row["source_id"] for row in here} == {"s0", "s1"} and {row["mic_id"] for row in here} == {"m0", "m1"}


def test_room_with_a_single_rir_is_fitted_and_not_scored(room_set, tmp_path):
    source = room_set("clean") / "fit"
    rows = read_rirs(source)
    rooms = sorted({row["room_id"] for row in rows})[:3]
    rows = [row for room, n in zip(rooms, (4, 4, 1), strict=True)
            for row in [row for row in rows if row["room_id"] == room][:n]]
    (tmp_path / "few").mkdir()
    write_rirs(tmp_path / "few", relocated(rows, source, tmp_path / "few"))
    session = fit_base_model(data_of(tmp_path / "few"), seed=0, nj=2)
    assert session.data.is_scored.tolist() == [True, True, False] and len(session.fit.local) == 3
    errors = heldout_errors(session)
    for split, of_split in errors.by_split.items():
        scored = np.isfinite(of_split).any(axis=1)
        assert (scored == (session.data.room < 2)).all() and len(errors.of_rooms(split)) == 2


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_round_trips_its_vector_and_changes_a_feature(name, session):
    effect = CATALOGUE[name]
    for start in effect.STARTS:
        np.testing.assert_allclose(effect.from_vector(np.array(start, dtype=float)).vector(), start, atol=1e-9)
    assert np.linalg.eigvalsh(effect.prior_covariance()).min() > 0.0
    index = session.index
    absorption = index.absorption(session.fit.mean, session.fit.local)
    state, changed = (index.state(absorption, []) for _ in range(2))
    moved = effect.from_vector(np.array(effect.STARTS[0]) + 0.5 * np.array(effect.SPREAD))
    moved.apply_to_prediction(changed, session.data, np.arange(len(session.data.rows)))
    assert not np.array_equal(predict(session.data, changed), predict(session.data, state))
    assert effect.DISCRIMINATING_MEASUREMENT


def test_no_effect_is_added_to_clean_rooms(closed):
    _, ledger = closed("clean")
    assert ledger["iterations"] == []
    assert ledger["final"] == ledger["baseline"]
    assert all(entry["share"] in (None, 0.0) for entry in ledger["explained"].values())


@pytest.mark.parametrize("kind", ["source_response", "noise_floor"])
def test_undeclared_effect_is_found(kind, closed):
    out, ledger = closed(kind)
    first = ledger["iterations"][0]
    assert first["effect"] == kind == first["ranking"][0]["effect"]
    assert first["heldout_error_after"] < first["heldout_error_before"] and first["p"] < 0.05
    test_before, test_after = (ledger["test"][when]["leave_positions_out"]["error"] for when in ("before", "after"))
    assert test_after < test_before
    assert kind in read_model(out / "model.json").names
    validate([out])


def test_noise_of_a_test_set_is_read_off_its_recordings(closed, room_set, tmp_path):
    quiet = close_loop([room_set("clean") / "fit"], tmp_path / "loop", test=[room_set("noise_floor") / "test"], nj=2)
    _, noisy = closed("noise_floor")
    assert quiet["iterations"] == []
    assert (quiet["test"]["measured"], noisy["test"]["measured"]) == (["noise_floor"], [])
    for split in SPLITS:
        before, after = (quiet["test"][when][split]["by_metric"]["floor"] for when in ("before", "after"))
        assert after < 0.5 * before
    validate([tmp_path / "loop"])


def test_effects_of_a_given_model_are_no_candidates(closed, room_set, tmp_path):
    out, before = closed("noise_floor")
    ledger = close_loop([room_set("noise_floor") / "fit"], tmp_path / "loop", model=out / "model.json", nj=2)
    assert ledger["given"] == read_model(out / "model.json").names
    assert not {candidate["effect"] for candidate in ledger["ranking"]} & set(ledger["given"])
    initial, final = (before[when]["leave_positions_out"]["error"] for when in ("baseline", "final"))
    assert ledger["baseline"]["leave_positions_out"]["error"] < 0.5 * (initial + final)
    assert ledger["iterations"] or (tmp_path / "loop/model.json").read_bytes() == (out / "model.json").read_bytes()
    validate([tmp_path / "loop"])


def test_fitted_response_has_the_true_shape(closed, room_set):
    """Only its shape: a level common to all frequencies is a gain, which is unknown."""
    out, _ = closed("source_response")
    (extension,) = [added for added in read_model(out / "model.json").extensions if added.effect is SourceResponse]
    clean, changed = ({row["id"]: (row, load_rir(directory, row)) for row in read_rirs(directory)}
                      for directory in (room_set("clean") / "fit", room_set("source_response") / "fit"))
    for source_id, response in extension.of.items():
        true_db = np.mean([measure_features(changed[name][1]).values[feature_slice("spectrum")]
                           - measure_features(rir).values[feature_slice("spectrum")]
                           for name, (row, rir) in clean.items() if row["source_id"] == source_id], axis=0)
        shape = np.array(response.gains_db)[:len(true_db)]
        upper = np.array(RESPONSE_HZ)[:len(true_db)] > 200.0
        error_db = (shape - true_db)[upper] - np.mean((shape - true_db)[upper])
        assert np.sqrt(np.mean(error_db ** 2)) < 1.0


def test_effect_outside_the_catalogue_is_reported_as_unexplained(closed):
    _, ledger = closed("harmonic_distortion")
    assert ledger["iterations"] == []
    assert ledger["unexplained"]["time_region"] == "ahead" and ledger["unexplained"]["size_jnd"] > 2.0
    assert "ahead" not in ledger["baseline"]["leave_positions_out"]["by_metric"]  # it is none of the model's errors


def test_single_loudspeaker_and_microphone_cannot_be_distinguished(room_set, tmp_path):
    directory = tmp_path / "one"
    rows = read_rirs(room_set("source_response") / "fit")
    directory.mkdir()
    write_rirs(directory, [row | dict(mic_id="the-mic") for row in relocated(
        [row for row in rows if row["source_id"] == "spk1"], room_set("source_response") / "fit", directory)])
    close_loop([directory], tmp_path / "loop", nj=2)
    first = read_json(tmp_path / "loop" / "ledger.json")["iterations"][0]
    assert {"source_response", "mic_response"} <= set(first["cannot_tell"]) and first["would_tell"]


def test_results_do_not_depend_on_nj(room_set, closed, tmp_path):
    out, _ = closed("noise_floor")
    close_loop([room_set("noise_floor") / "fit"], tmp_path / "loop", test=[room_set("noise_floor") / "test"], nj=1)
    for name in ("ledger.json", "model.json"):
        assert (tmp_path / "loop" / name).read_bytes() == (out / name).read_bytes()


@pytest.mark.parametrize("argv, message", [
    (["{two}", "--out", "out"], "needs 3 rooms or conditions (room_id) with two usable RIRs each, and has 2"),
    (["{two}", "--out", "out", "--max-effects", "-1"], "max_effects=-1 must lie in"),
    (["{two}", "{two}", "--out", "out"], "give each RIR once"),
    (["absent", "--out", "out"], "absent"),
])
def test_bad_input_is_refused_in_one_line(argv, message, room_set, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = room_set("clean") / "fit"
    rows = read_rirs(source)
    rooms = sorted({row["room_id"] for row in rows})[:2]
    rows = [row for row in rows if row["room_id"] in rooms]
    two = tmp_path / "two"
    two.mkdir()
    write_rirs(two, relocated(rows, source, two))
    assert main(["close-loop", *(word.replace("{two}", str(two)) for word in argv)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and message in lines[0] and not (tmp_path / "out").exists()
