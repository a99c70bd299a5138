"""Decisions of the loop: predicted features, steps of a fit, tests of an effect, and what replaces a rejected one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.core.constants import BANDS_HZ
from roomeq.effects.mic_response import MicResponse
from roomeq.effects.model import Extension, Model
from roomeq.effects.noise_floor import NoiseFloor
from roomeq.effects.response import RESPONSE_HZ
from roomeq.effects.room_eq import RoomEq
from roomeq.effects.sound_speed import SoundSpeed
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import acceptance, close, heldout_errors, selection
from roomeq.loop.acceptance import NO_CLEAR_FALL, RISES, describe_rejection
from roomeq.loop.close import _model_of, _moments
from roomeq.loop.features import JND, LATE_S, METRIC, N_FEATURES, SHOW_DIRECT_SOUND, feature_slice
from roomeq.loop.fit import SharedPrior, _best_shape, shortened_step, solve_step
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors, p_lower, share_of_fall
from roomeq.loop.likelihood import NormalEquations, scatter
from roomeq.loop.predict import base_state, predict
from roomeq.loop.selection import Candidate, weights_of
from roomeq.loop.splitters import rooms_by_devices
from roomeq.loop.tables import FRAME_EDGES_S, Table
from roomeq.loop.unexplained import find_unexplained
from roomeq.records.schema import unit_name


@pytest.mark.parametrize("to, expected", [(1.0, 1.0), (3.0, 1.5), (9.0, 1.8), (-1.0, 0.0)])
def test_step_is_shortened_until_it_lowers_the_cost(to, expected):
    mean, local, reached = shortened_step(lambda mean, local: (mean[0] - 1.1) ** 2, 1.1 ** 2,
                                          (np.zeros(1), [np.zeros(2)]), (np.array([to]), [np.array([to, 2.0 * to])]))
    assert mean[0] == pytest.approx(expected)
    assert reached == pytest.approx((expected - 1.1) ** 2)
    np.testing.assert_allclose(local[0], [expected, 2.0 * expected])


def test_damping_freezes_poorly_determined_parameters():
    information = np.diag([1e4, 0.5])
    room = NormalEquations(information, np.zeros((2, 0)), np.zeros((0, 0)), information @ [0.3, 3.0], np.zeros(0), 1.0,
                           0.0, np.zeros(0, dtype=int))
    prior = SharedPrior(np.zeros(0), np.zeros((0, 0)))
    steps = [solve_step([room], [np.eye(2)], np.zeros(0), [np.zeros(2)], prior, damping)[1][0]
             for damping in (0.0, 30.0)]
    np.testing.assert_allclose(steps[0], [0.3, 1.0], rtol=1e-3)
    np.testing.assert_allclose(steps[1], [0.3, 1.5 / 31.5], rtol=1e-2)


@pytest.mark.parametrize("gain, size_jnd, helps", [
    ([1.1, 3.4, 7.7, -0.7, 1.4, -0.4, 7.1, -0.2], 1.5, True),  # some rooms gain little
    ([0.7, 0.1, -0.1, 0.1, -0.5, 0.1, 12.0, 0.3], 1.5, False),  # one room alone gains
    ([0.5, 0.6, 0.4, 0.5, 0.6, 0.5, 0.4, 0.6], 1.5, False),  # a little in all rooms: too little for 11 candidates
    ([5.0] * 8, 0.4, False),  # inaudible
    ([-1.0] * 8, 1.5, False)])
def test_effect_helps_if_all_rooms_but_the_best_gain(gain, size_jnd, helps):
    assert Candidate(SoundSpeed, None, np.array(gain), size_jnd).helps(11) == helps


@pytest.mark.parametrize("behind, told_apart", [(1.0, False), (19.0, True)])
def test_effect_of_one_room_is_told_from_one_that_fits_far_worse(behind, told_apart):
    """The test over rooms says nothing of effects in a single room."""
    best, other = (Candidate(effect, None, np.array([gain, *[0.0] * 7]), 1.5)
                   for effect, gain in ((NoiseFloor, 30.0), (DeclaredNoise, 30.0 - behind)))
    chosen, alike = selection.choose([best, other], 11)
    assert chosen is best and (alike == []) is told_apart


class DeclaredNoise(NoiseFloor):
    """Another effect that is read off the recordings."""


@pytest.mark.parametrize("extra_jnd", [0.0, 6.0])
def test_residual_of_one_room_is_unexplained_if_it_is_an_outlier(extra_jnd):
    rng = np.random.default_rng(1)
    room = np.repeat(np.arange(8), 8)
    residual = rng.normal(0.0, 0.7, (64, N_FEATURES)) + rng.normal(0.0, 0.3, (8, N_FEATURES))[room]
    residual[room == 5, feature_slice("t30").start + 3] += extra_jnd
    data = SimpleNamespace(room=room, room_names=list("abcdefgh"), units=lambda scope: (["one"], np.zeros(64, int)))
    unexplained = find_unexplained(SimpleNamespace(data=data, residual=residual))
    if extra_jnd:
        first = unexplained[0]
        assert (first.metric, first.varies_with, first.bands_hz) == ("t30", "room", [BANDS_HZ[3]])
        assert first.size_jnd == pytest.approx(extra_jnd, abs=1.0)
    assert len(unexplained) == (extra_jnd > 0.0)


def test_residual_of_all_bands_is_unexplained_where_few_rooms_measure_it():
    rng = np.random.default_rng(3)
    room = np.repeat(np.arange(8), 8)
    ahead = feature_slice("ahead")
    residual = rng.normal(0.0, 0.7, (64, N_FEATURES))
    residual[room > 4, ahead] = np.nan
    devices = ["one", "two"], np.arange(64) % 2
    data = SimpleNamespace(room=room, room_names=list("abcdefgh"), units=lambda scope: devices)
    assert not find_unexplained(SimpleNamespace(data=data, residual=residual))
    of_room = np.array([3.8, 4.6, 5.0, 5.4, 6.2, 0.0, 0.0, 0.0])[:, None]
    residual[:, ahead] += (of_room + rng.normal(0.0, 0.7, (8, ahead.stop - ahead.start)))[room]
    found, = find_unexplained(SimpleNamespace(data=data, residual=residual))
    assert (found.metric, found.varies_with) == ("ahead", "nothing")
    assert found.size_jnd == pytest.approx(5.0, abs=0.5)


def test_scatter_of_many_devices_is_not_unexplained():
    room, source, mic = (number.ravel() for number in np.meshgrid(range(5), range(4), range(30), indexing="ij"))
    numbers = dict(source=source, mic=mic)
    data = SimpleNamespace(room=room, room_names=list("abcde"), units=lambda scope: (
        [str(n) for n in np.unique(numbers[scope])], numbers[scope]))
    rng = np.random.default_rng(0)
    found = [bool(find_unexplained(SimpleNamespace(data=data, residual=rng.normal(0.0, 3.0, (len(room), N_FEATURES)))))
             for _ in range(20)]
    assert sum(found) <= 3  # 5 % of 20, and a margin of two standard deviations


def test_room_without_a_metric_says_nothing_of_the_bands_that_ring_elsewhere():
    rng = np.random.default_rng(1)
    room = np.repeat(np.arange(12), 8)
    residual = rng.normal(0.0, 0.7, (96, N_FEATURES))
    at = feature_slice("t30")
    for r in range(8):
        residual[room == r, at.start + 4 + r % 2] += 6.0
    residual[room >= 8, at] = np.nan
    devices = ["one"], np.zeros(96, int)
    data = SimpleNamespace(room=room, room_names=list("abcdefghijkl"), units=lambda scope: devices)
    first = find_unexplained(SimpleNamespace(data=data, residual=residual))[0]
    assert (first.metric, first.bands_hz) == ("t30", [BANDS_HZ[4], BANDS_HZ[5]])
    assert first.size_jnd == pytest.approx(6.0, abs=0.5)


def test_object_that_rings_at_one_octave_in_half_of_the_rooms_is_unexplained():
    rng = np.random.default_rng(2)
    room = np.repeat(np.arange(8), 8)
    residual = rng.normal(0.0, 0.3, (64, N_FEATURES))
    t20, t30 = feature_slice("t20").start, feature_slice("t30").start
    decay = rng.normal(0.0, 1.5, (64, 8))  # scatters alike in both
    residual[:, t20:t20 + 8] += decay
    residual[:, t30:t30 + 8] += decay
    data = SimpleNamespace(room=room, room_names=list("abcdefgh"), units=lambda scope: (["one"], np.zeros(64, int)))
    assert not find_unexplained(SimpleNamespace(data=data, residual=residual))
    residual[room < 4, t30 + 4] += 3.0
    first = find_unexplained(SimpleNamespace(data=data, residual=residual))[0]
    assert (first.metric, first.time_region, first.bands_hz, first.varies_with) == (
        "curvature", "late", [BANDS_HZ[4]], "room")
    assert first.size_jnd == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("faster", [1.0, 1.03, 0.9])
def test_predicted_features_follow_the_speed_of_sound(faster):
    rate = 14.0  # decay rate at the declared speed [1/s]
    arriving = np.exp(-rate * FRAME_EDGES_S[:-1]) - np.exp(-rate * FRAME_EDGES_S[1:])
    counts = np.zeros((len(arriving), 6))
    counts[:, 0] = arriving
    entries = np.stack([np.arange(len(arriving)), np.zeros(len(arriving), int)], axis=1)
    data = SimpleNamespace(
        rows=[{}], room=np.zeros(1, int), given_to=[], tables=[Table(entries, counts, 1.0, False)],
        distance_m=np.ones(1), speed_m_s=np.array([343.0]), air_per_m=np.zeros((1, 8)), white=np.full((1, 8), 1e-9),
        frame_edges_s=FRAME_EDGES_S)
    state = base_state(data, np.full((1, 2, 8), 0.1))
    state.speed_m_s = faster * data.speed_m_s
    (features,) = predict(data, state)
    left = np.exp(-rate * faster * np.array([0.05, LATE_S]))
    c50_db = 10.0 * np.log10(1.0 / left[0] - 1.0)
    np.testing.assert_allclose(features[feature_slice("c50")], c50_db / JND["c50"], atol=0.05)
    np.testing.assert_allclose(features[feature_slice("late")], 10.0 * np.log10(left[0] - left[1]), atol=0.05)
    log_t30 = np.log(6.0 * np.log(10.0) / rate / faster)
    np.testing.assert_allclose(features[feature_slice("t30")], log_t30 / JND["t30"], atol=0.2)


@pytest.mark.parametrize("delay_s, in_gate", [(0.0, 1.0), (2.0e-3, 1.0), (3.0e-3, 0.0)])
def test_direct_sound_that_misses_its_gate_counts_as_early(delay_s, in_gate):
    data = SimpleNamespace(
        rows=[{}], room=np.zeros(1, int), given_to=[], distance_m=np.ones(1), speed_m_s=np.array([343.0]),
        tables=[Table(np.array([[1, 0]]), np.full((1, 6), 1e-9), 1.0, True)],
        air_per_m=np.zeros((1, 8)), white=np.full((1, 8), 1e-9), frame_edges_s=FRAME_EDGES_S)
    state = base_state(data, np.full((1, 2, 8), 0.1))
    state.delay_s[:] = delay_s
    (features,) = predict(data, state)
    level_db = -20.0 * np.log10(4.0 * np.pi)
    loud, quiet = ("direct", "early") if in_gate else ("early", "direct")
    np.testing.assert_allclose(features[feature_slice(loud)], level_db, atol=0.1)
    assert np.all(features[feature_slice(quiet)] < level_db - 24.0)


ROOMS_AND_HALVES = np.repeat(np.arange(8), 2), np.tile([0, 1], 8)
STRONG_IN_TWO_ROOMS = [[0.30, 0.28], [0.12, 0.11]] + [[0.02, 0.0], [0.0, 0.01]] * 3


@pytest.mark.parametrize("split, of_halves, lower", [
    ("leave_positions_out", STRONG_IN_TWO_ROOMS, True),
    ("leave_room_out", STRONG_IN_TWO_ROOMS, False),  # no evidence about the next room
    ("leave_room_out", [[0.10, 0.12]] * 4 + [[0.08, 0.07]] * 4, True),
    ("leave_positions_out", [[0.30, -0.28], [0.12, -0.11]] + [[0.02, 0.0], [0.0, 0.01]] * 3, False),  # by chance
    ("leave_positions_out", [[0.30, 0.0]] + [[0.01, -0.01]] * 7, False),  # a single group must not decide
    ("leave_positions_out", [[0.0, 0.0]] * 8, False)])
def test_p_of_a_lower_error_depends_on_the_split(split, of_halves, lower):
    before = np.full((16, N_FEATURES), 2.0)
    after = before - np.ravel(of_halves)[:, None]
    errors_before, errors_after = (HeldOutErrors({split: errors}, *ROOMS_AND_HALVES) for errors in (before, after))
    p = p_lower(errors_before, errors_after, split)
    assert (p < 0.025) == lower


@pytest.mark.parametrize("split", SPLITS)
def test_weights_of_features_replace_those_of_metrics(split):
    """Levels of three bands fall by 0.5 JND in all rooms; the one decay time that changes too scatters by 5 JND."""
    before, rng = np.full((16, N_FEATURES), 3.0), np.random.default_rng(0)
    low, decay = np.flatnonzero(METRIC == "spectrum")[:3], np.flatnonzero(METRIC == "t30")[0]
    touched = np.zeros((16, N_FEATURES), dtype=bool)
    touched[:, [*low, decay]] = True
    after = before.copy()
    after[:, low] -= 0.5
    after[:, decay] += 2.0 * rng.standard_normal(16)
    after[:, METRIC == "edt"] += 9.0  # which the effect does not touch
    errors_before, errors_after = (HeldOutErrors({split: errors}, *ROOMS_AND_HALVES) for errors in (before, after))
    assert p_lower(errors_before, errors_after, split, touched) < 0.02 < p_lower(errors_before, errors_after, split)
    assert 0.05 < share_of_fall(errors_before, errors_after, split, touched) < 0.2
    assert p_lower(errors_before, errors_after, split, np.zeros_like(touched)) == 1.0


def test_features_weigh_by_their_predicted_change_over_their_variance(monkeypatch):
    """The arrival changes by 2 JND and scatters by 0.5; a level changes by 0.5 and scatters by 2; another hardly."""
    change = np.zeros((3, N_FEATURES))
    change[:, :3] = [2.0, -0.5, 0.2]
    monkeypatch.setattr(selection, "change_by", lambda *_: change)
    sigma, omega = np.ones(N_FEATURES), np.zeros(N_FEATURES)
    sigma[:2], omega[:2] = [0.4, 2.0], [0.3, 0.0]
    weights = weights_of(None, SimpleNamespace(data=None, fit=SimpleNamespace(sigma=sigma, omega=omega)))
    assert weights[0, 0] / weights[0, 1] == pytest.approx(2.0 / 0.25 / (0.5 / 4.0))
    assert not np.any(weights[:, 2:])


def test_direct_sound_that_told_a_facing_says_nothing_of_a_directivity(monkeypatch):
    """The axis of the first RIR follows from its direct sound; that of the second is stated."""
    monkeypatch.setattr(selection, "change_by", lambda *_: np.ones((2, N_FEATURES)))
    session = SimpleNamespace(data=SimpleNamespace(axis=np.array([0, -1])),
                              fit=SimpleNamespace(sigma=np.ones(N_FEATURES), omega=np.zeros(N_FEATURES)))
    of_directivity, of_response = (weights_of(effect, session) > 0.0 for effect in (SourceDirectivity, SourceResponse))
    assert not of_directivity[0, SHOW_DIRECT_SOUND].any() and of_directivity[0, ~SHOW_DIRECT_SOUND].all()
    assert of_directivity[1].all() and of_response.all()
    session.data.axis = np.empty(0, dtype=int)  # no facing was estimated
    assert weights_of(SourceDirectivity, session).all()


def test_p_of_few_halves_is_the_mid_p_value():
    """Of six halves that all fall, no more extreme sign is possible: half of 1 / 64."""
    before = np.full((6, N_FEATURES), 3.0)
    after = before - np.linspace(0.5, 1.0, 6)[:, None]
    split = "leave_positions_out"
    errors_before, errors_after = (HeldOutErrors({split: errors}, np.repeat(np.arange(3), 2), np.tile([0, 1], 3))
                                   for errors in (before, after))
    assert p_lower(errors_before, errors_after, split) == pytest.approx(0.5 / 64)
    assert p_lower(errors_after, errors_before, split) == pytest.approx(1.0 - 0.5 / 64)
    assert p_lower(errors_before, errors_before, split) == pytest.approx(0.5)


@pytest.mark.parametrize("n_halves", [5, 18, 19])
def test_mid_p_value_is_the_share_of_signs_with_a_larger_mean(n_halves):
    """Up to 18 halves, all signs are tried, as here one by one; of more, a sample."""
    rng = np.random.default_rng(n_halves)
    change = np.round(rng.normal(0.3, 1.0, n_halves), 1)  # with ties
    signs = 1 - 2 * (np.arange(2 ** n_halves)[:, None] >> np.arange(n_halves) & 1)
    above = np.round(signs @ change - change.sum(), 6)
    expected = np.mean(above > 0.0) + 0.5 * np.mean(above == 0.0)
    assert heldout_errors._mid_p_of_signs(change) == pytest.approx(expected, abs=1e-12 if n_halves < 19 else 0.01)


def test_rooms_without_what_an_effect_touches_count_as_rooms_without_a_fall():
    """An effect in two rooms, where the error falls by the same, says little about the next."""
    room, touched = ROOMS_AND_HALVES[0], np.zeros((16, N_FEATURES), dtype=bool)
    touched[room < 2, 0] = True
    before, after = np.full((16, N_FEATURES), 3.0), np.full((16, N_FEATURES), 3.0)
    after[touched] = np.repeat([2.0, 1.95], 2)
    split = "leave_room_out"
    errors_before, errors_after = (HeldOutErrors({split: errors}, *ROOMS_AND_HALVES) for errors in (before, after))
    assert p_lower(errors_before, errors_after, split, touched) > 0.05


@pytest.mark.parametrize("level", [0.05, 0.6])
def test_few_rooms_of_equal_absorption_do_not_fix_the_level_of_the_next(level):
    rooms = [np.concatenate([level * x + 0.1 * np.cos(np.arange(8) + x), np.zeros(8)]) for x in (-1.2, -0.3, 0.4, 1.1)]
    found, _, _ = _best_shape(rooms, [1e-4 * np.eye(16)] * len(rooms))
    assert 0.3 <= found <= 0.6


@pytest.mark.parametrize("change, behind, helps_beside, added", [
    (0.3, 8.0, False, "sound_speed"),
    (-0.3, 8.0, False, "noise_floor"),  # refuted: the next best is tried
    (0.015, 8.0, False, None),  # so little may be another scattering
    (0.0, 8.0, False, None),  # not proven: no worse-fitting candidate replaces it
    (0.0, 8.0, True, "noise_floor"),  # unless it explains something else
    (0.0, 0.0, False, "noise_floor")])  # an equally good one does
def test_worse_fit_replaces_only_a_refuted_candidate(monkeypatch, change, behind, helps_beside, added):
    gain = 20.0 + np.arange(8)
    ranking = [Candidate(SoundSpeed, SoundSpeed, gain, 2.0),
               Candidate(NoiseFloor, NoiseFloor, gain - behind + np.tile([1.0, -1.0], 4), 2.0)]
    monkeypatch.setattr(close, "helps_beside", lambda *_: helps_beside)
    assert accepted(ranking, {SoundSpeed: change, NoiseFloor: 0.3}, monkeypatch) == added


@pytest.mark.parametrize("effect, change, added", [
    (NoiseFloor, 0.003, "noise_floor"), (NoiseFloor, -0.03, "noise_floor"), (NoiseFloor, -0.1, None),
    (SoundSpeed, 0.003, None)])
def test_what_was_read_off_the_recordings_needs_no_significant_fall(monkeypatch, effect, change, added):
    ranking = [Candidate(effect, effect, 20.0 + np.arange(8), 2.0)]
    assert accepted(ranking, {effect: change}, monkeypatch) == added


@pytest.mark.parametrize("touched, elsewhere, added", [
    (True, 0.0, True), (True, 0.03, True), (True, -0.1, False), (False, 0.0, False), (False, 0.03, False)])
def test_effect_is_judged_by_the_features_that_it_touches(monkeypatch, touched, elsewhere, added):
    """The arrival falls by 0.4 JND, and all others fall by `elsewhere` with a scatter that would hide it."""
    arrival = np.zeros((16, N_FEATURES), dtype=bool)
    arrival[:, feature_slice("arrival")] = True

    def errors(model):
        scatter = np.repeat(np.tile([0.1, -0.1], 4), 2)[:, None]
        after = np.where(arrival, 1.6, 2.0 - elsewhere + scatter)
        return HeldOutErrors(dict.fromkeys(SPLITS, after if model else np.full(arrival.shape, 2.0)), *ROOMS_AND_HALVES)

    found = accept([Candidate(SoundSpeed, SoundSpeed, 20.0 + np.arange(8), 2.0)], errors,
                   arrival if touched else ~arrival, monkeypatch)
    assert (found == "sound_speed") == added


@pytest.mark.parametrize("effect, predicted, reason", [
    (SoundSpeed, 0.01, NO_CLEAR_FALL), (SoundSpeed, -0.03, NO_CLEAR_FALL), (SoundSpeed, -0.3, RISES),
    (SoundSpeed, 0.3, None), (NoiseFloor, -0.3, None)])
def test_effect_whose_predicted_error_hardly_falls_is_not_rendered(monkeypatch, effect, predicted, reason):
    scatter = np.repeat(np.tile([0.02, -0.02], 4), 2)[:, None]

    def errors(model):
        features = 2.0 - (predicted + scatter) * (model is effect) + np.zeros((16, N_FEATURES))
        return HeldOutErrors(dict.fromkeys(SPLITS, features), *ROOMS_AND_HALVES)

    monkeypatch.setattr(acceptance, "weights_of", lambda *_: np.ones((16, N_FEATURES), dtype=bool))
    monkeypatch.setattr(acceptance, "predicted_errors", errors)
    monkeypatch.setattr(close, "predicted_errors", errors)
    trial = acceptance.judge_predicted(effect, lambda: errors(None), effect)
    assert (trial.reason, trial.rendered) == (reason, False) if reason else trial is None
    monkeypatch.setattr(close, "refit", lambda *_: effect)
    monkeypatch.setattr(close, "refit_rendered", lambda *_, **__: pytest.fail("was rendered"))
    if reason:
        _, rejected = close._accept(SimpleNamespace(data=None, effects=(), seed=0, nj=1), None, lambda: errors(None),
                                    [Candidate(effect, effect, 20.0 + np.arange(8), 2.0)], np.zeros(0, dtype=int))
        assert rejected == {effect: trial}
        assert describe_rejection(trial).startswith("predicted, the held-out error")


def accepted(ranking, lower, monkeypatch):
    """Return the name of the effect that is added if each lowers the error by so much, or None."""
    def errors(model):
        by_room = np.repeat(np.tile([0.02, -0.02], 4), 2)[:, None] * (model is not None)
        features = 2.0 - lower.get(model, 0.0) + by_room + np.zeros((16, N_FEATURES))
        return HeldOutErrors(dict.fromkeys(SPLITS, features), *ROOMS_AND_HALVES)

    return accept(ranking, errors, np.ones((16, N_FEATURES), dtype=bool), monkeypatch)


def accept(ranking, errors, touched, monkeypatch):
    """Return the name of the effect that is added, or None; `errors` maps an effect or None to held-out errors."""
    monkeypatch.setattr(acceptance, "weights_of", lambda *_: touched)
    monkeypatch.setattr(close, "refit", lambda session, fitted: fitted)
    monkeypatch.setattr(close, "judge_predicted", lambda *_: None)
    monkeypatch.setattr(close, "_faced_as_fitted", lambda fitted, unknown, effect: f"faced as with {effect.NAME}")
    monkeypatch.setattr(close, "refit_rendered", lambda data, fitted, **_: (
        fitted if data == f"faced as with {fitted.NAME}" else pytest.fail(data)))
    monkeypatch.setattr(close, "heldout_errors", errors)
    monkeypatch.setattr(close, "iteration_entry", lambda winner, *_: dict(effect=winner.effect.NAME))
    found, _ = close._accept(SimpleNamespace(data=None, effects=(), seed=0, nj=1), errors(None),
                             lambda: errors(None), ranking, np.zeros(0, dtype=int))
    return found and found.entry["effect"]


@pytest.mark.parametrize("effect, p, added", [
    (SoundSpeed, (0.001, 0.9), True), (SoundSpeed, (0.02, 0.2), False), (SoundSpeed, (0.03, 0.04), True),
    (RoomEq, (0.001, 0.9), False), (RoomEq, (0.03, 0.04), True)])  # an equaliser is the same in all rooms
def test_evidence_of_both_splits_counts_together(monkeypatch, effect, p, added):
    monkeypatch.setattr(acceptance, "p_with_other_devices", lambda *_: 0.01)
    values = dict(zip(SPLITS, p, strict=True))
    monkeypatch.setattr(acceptance, "p_lower", lambda before, after, split, weights=None: (
        values[split] if after.by_split[split].mean() < 1.9 else 1.0 - values[split]))
    ranking = [Candidate(effect, effect, 20.0 + np.arange(8), 2.0)]
    assert (accepted(ranking, {effect: 0.3}, monkeypatch) is not None) == added


@pytest.mark.parametrize("effect, p, added", [(RoomEq, 0.04, True), (RoomEq, 0.06, False), (SoundSpeed, 0.06, True)])
def test_equaliser_must_hold_with_other_devices(monkeypatch, caplog, effect, p, added):
    monkeypatch.setattr(acceptance, "p_with_other_devices", lambda *_: p)
    ranking = [Candidate(effect, effect, 20.0 + np.arange(8), 2.0)]
    with caplog.at_level("INFO"):
        assert (accepted(ranking, {effect: 0.3}, monkeypatch) is not None) == added
    assert ("in rooms with other devices" in caplog.text) != added


def data_of_devices(rows):
    """Return what the loop's data tell about rooms and devices."""
    names = {scope: sorted({row[f"{scope}_id"] for row in rows}) for scope in ("room", "source", "mic")}
    units = {scope: (found, np.array([found.index(row[f"{scope}_id"]) for row in rows]))
             for scope, found in names.items()}
    return SimpleNamespace(room=units["room"][1], room_names=names["room"], units=units.get)


def test_rooms_that_share_devices_are_a_group():
    rows = [dict(room_id=f"r{room}", source_id=source, mic_id=mic) for room, source, mic in (
        (0, "s0", "m0"), (1, "s1", "m1"), (2, "s2", "m0"), (3, "s1", "m3"), (4, "s4", "m4"))]
    group = rooms_by_devices(data_of_devices(rows))
    assert group[0] == group[2] and group[1] == group[3] and len(set(group)) == 3


def test_laboratories_count_alike_in_a_typical_microphone():
    """An array of nine is of one laboratory, and the microphone of another counts as much as all of them."""
    rows = [*(dict(room_id="a", source_id="s0", mic_id=f"a{mic}") for mic in range(9)),
            dict(room_id="b", source_id="s1", mic_id="b0"), dict(room_id="c", source_id="s1", mic_id="c0")]
    gains_db = np.outer([-9.0] * 9 + [1.0, 5.0], np.ones(len(RESPONSE_HZ)))
    session = SimpleNamespace(data=data_of_devices(rows), effects=(MicResponse,),
                              fit=SimpleNamespace(mean=None, local=None),
                              index=SimpleNamespace(vectors=lambda *_: [gains_db]))
    (extension,) = _model_of(session, Model()).extensions
    np.testing.assert_allclose(extension.typical, -3.0)  # (-9 + (1 + 5) / 2) / 2
    shares = np.array([*[1 / 18] * 9, 1 / 4, 1 / 4])
    variance = 0.5 * 6.0 ** 2 + 0.25 * 4.0 ** 2 + 0.25 * 8.0 ** 2
    np.testing.assert_allclose(extension.spread, np.sqrt(variance / (1.0 - shares @ shares)))
    assert list(extension.of) == session.data.units("mic")[0]


@pytest.mark.parametrize("group", [[4, 4, 4, 4, 4], [3, 1, 0, 2, 4]])
def test_devices_count_alike_in_groups_of_one_size(group):
    vectors = np.random.default_rng(0).standard_normal((5, 3))
    mean, spread = _moments(vectors, np.array(group))
    np.testing.assert_allclose(mean, vectors.mean(axis=0))
    np.testing.assert_allclose(spread, vectors.std(axis=0, ddof=1))
    assert not np.any(_moments(vectors[:1], np.zeros(1, dtype=int))[1])


def test_room_that_is_far_off_keeps_its_scatter():
    """A room 22 dB off scatters as much as before; the scatter had seemed to be 0, which rewarded the offset."""
    rng = np.random.default_rng(0)
    room = np.repeat(np.arange(4), (130, 10, 10, 10))
    residual = rng.standard_normal((len(room), N_FEATURES)) * 3.0
    data = SimpleNamespace(room=room, room_names=["a", "b", "c", "d"])
    valid = np.ones_like(residual, dtype=bool)
    sigma, _ = scatter(data, residual, valid)
    off, omega = scatter(data, residual + 22.0 * (room == 0)[:, None], valid)
    np.testing.assert_allclose(off, sigma, rtol=1e-6)
    assert np.all(omega[METRIC != "floor"] > 1.0)


def test_unnamed_devices_of_two_corpora_are_two():
    rows = [dict(source_id="unknown", corpus=corpus) for corpus in "ab"]
    assert [unit_name(row, "source") for row in rows] == ["unknown of a", "unknown of b"]
    assert unit_name(dict(mic_id="m1", corpus="a"), "mic") == "m1"
    named = {"unknown of a": SourceResponse.from_vector(np.full(len(SourceResponse.SPREAD), -3.0))}
    extension = Extension(SourceResponse, named, np.zeros(len(SourceResponse.SPREAD)),
                          np.ones(len(SourceResponse.SPREAD)))
    assert extension.for_row(rows[0], 0) is named["unknown of a"]
    assert extension.for_row(rows[1], 0) is not named["unknown of a"]


def test_errors_by_metric_and_by_band_weigh_rooms_the_same():
    errors = np.full((5, N_FEATURES), 4.0)
    errors[0] = 1.0  # the only RIR of its room
    found = HeldOutErrors({split: errors for split in SPLITS}, np.array([0, 1, 1, 1, 1]), np.zeros(5, dtype=int))
    assert set(found.by_metric(SPLITS[0]).values()) == {2.5} and set(found.by_band(SPLITS[0])) == {2.5}
    assert found.mean(SPLITS[0]) == 2.5
    after = replace(found, by_split={split: 0.5 * errors for split in SPLITS})
    low, high = found.fall_interval(after, SPLITS[0])
    assert low < 1.25 < high and (low + high) / 2.0 == pytest.approx(1.25)
