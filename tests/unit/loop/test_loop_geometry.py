"""Estimated geometry: hidden heights are found, right documents are kept, wrong ones are replaced."""

from types import SimpleNamespace

import numpy as np
import pytest
from echoes import echo_room
from rirmaker import row

from roomeq.effects.model import Model
from roomeq.loop.annealing import Block, anneal
from roomeq.loop.arrivals import Arrivals, early_images, heard_probability, log_likelihood, measure_arrivals
from roomeq.loop.close import _with_places_of
from roomeq.loop.geometry import Estimate, _possible, complete_room, unknown_heights_m
from roomeq.loop.unknown_geometry import HEIGHT_M, UnknownGeometry

POSITIONS = ("source_pos_m", "mic_pos_m")


def complete(seed, **options):
    """Return the completed rows of a room, its estimates by quantity, its documented rows and the truth."""
    rows, rirs, truth = echo_room(seed, **options)
    completed = complete_room(rows, [measure_arrivals(rir) for rir in rirs], seed=0)
    return completed.rows, {estimate.quantity: estimate for estimate in completed.estimates}, rows, truth


def test_heights_of_sources_are_found_where_those_of_microphones_are_known():
    rows, estimates, _, truth = complete(3, known=["mic_pos_m"])
    for n in range(2):
        estimate = estimates[f"height of source s{n}"]
        true_m = truth[f"height of source s{n}"]
        assert estimate.used and estimate.documented is None and estimate.posterior[1] < 0.1
        assert estimate.posterior[0] == pytest.approx(true_m, abs=0.06)
        assert {row["source_pos_m"][2] for row in rows if row["source_id"] == f"s{n}"} == {
            round(estimate.posterior[0], 4)}


def test_heights_that_recordings_tell_and_no_row_states_are_for_the_simulator():
    estimates, truth = complete(3, known=["mic_pos_m"])[1::2]
    heights_m = unknown_heights_m([*estimates.values()])
    assert heights_m == {"room3": {f"source s{n}": pytest.approx(truth[f"height of source s{n}"], abs=0.06)
                                  for n in range(2)}}
    assert unknown_heights_m([Estimate("hall", "height of source s", "m", HEIGHT_M, HEIGHT_M, None, 0.0, True)]) == {}


def test_model_holds_heights_of_other_sets_where_the_training_set_tells_none():
    def told(height_m, *devices):
        return SimpleNamespace(estimates=[Estimate(room, f"height of {device}", "m", HEIGHT_M, (height_m, 0.02), None,
                                                   0.0, True) for room, device in devices])

    test_set = told(1.2, ("office", "source s"), ("office", "microphone m"), ("hall", "source s"))
    base = Model(heights_m={"office": {"source s": 1.0}, "hall": {"source s": 1.0}, "home": {"source s": 1.0}})
    model = _with_places_of(told(1.5, ("office", "source s")), _with_places_of(test_set, base))
    assert model.heights_m == {"office": {"source s": 1.5, "microphone m": 1.2}, "hall": {"source s": 1.2},
                               "home": {"source s": 1.0}}


def test_height_that_some_rows_of_a_device_lack_has_its_plain_name():
    known = row("a", source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[3.0, 1.0, 1.1])
    rows = [known, known | dict(id="b", source_pos_m=[1.0, 2.0, None])]
    unknowns = UnknownGeometry(rows, [Arrivals(0.0, np.ones(720))] * 2).unknowns
    assert {unknown.quantity for unknown in unknowns if "source" in unknown.quantity} == {
        f"height of source {known['source_id']}, documented at 1.5 m", f"height of source {known['source_id']}"}


def test_documents_that_are_right_to_a_centimetre_are_kept():
    rows, estimates, documented, _ = complete(4, known=POSITIONS)
    assert rows == documented
    assert not any(estimate.used for estimate in estimates.values())
    assert estimates["height of the room"].evidence < 0.0


def test_ceiling_thirteen_centimetres_below_the_documented_is_replaced():
    rows, estimates, documented, truth = complete(5, known=POSITIONS, ceiling_off_m=0.13)
    ceiling = estimates["height of the room"]
    assert ceiling.used and ceiling.posterior[0] == pytest.approx(truth["height of the room"], abs=0.03)
    assert rows[0]["room_dims_m"] == [*documented[0]["room_dims_m"][:2], round(ceiling.posterior[0], 4)]
    assert "documented" in str(ceiling)


def test_recordings_that_tell_nothing_leave_the_prior():
    rows, _, _ = echo_room(6, n_sources=1, n_mics=2)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, 4000)) * np.exp(-np.arange(4000) / 1000.0)
    noise[:, 100] = 10.0
    completed = complete_room(rows, [measure_arrivals(rir) for rir in noise], seed=0)
    source = next(estimate for estimate in completed.estimates if "source" in estimate.quantity)
    assert source.posterior[0] == pytest.approx(HEIGHT_M[0], abs=0.25) and source.posterior[1] > 0.15
    assert abs(source.evidence) < 1.0


def test_latency_of_recordings_with_time_of_flight_is_found():
    rows, rirs, _ = echo_room(7, known=POSITIONS, tof_removed=False)
    late = [np.concatenate([np.zeros(8), rir])[:len(rir)] for rir in rirs]
    estimates = complete_room(rows, [measure_arrivals(rir) for rir in late], seed=0).estimates
    latency = next(estimate for estimate in estimates if estimate.quantity == "latency")
    assert latency.posterior[0] == pytest.approx(0.5, abs=0.1) and not latency.used


def test_documented_height_is_kept_where_the_estimate_is_too_close_to_the_microphone():
    geometry = UnknownGeometry([row("r", source_pos_m=[1.0, 1.0, 1.0], mic_pos_m=[1.0, 1.02, 1.1])],
                               [Arrivals(0.0, np.ones(720))])
    estimates = [Estimate("hall", unknown.quantity, unknown.unit, (unknown.mean, unknown.sd),
                          (1.08 if "source" in unknown.quantity else unknown.mean, 0.01), unknown.documented, 2.0,
                          unknown.unit == "m") for unknown in geometry.unknowns]
    used = {estimate.quantity for estimate in _possible(geometry, estimates) if estimate.used}
    assert used == {"length of the room", "width of the room", "height of the room"}


def test_estimates_do_not_change_between_runs():
    first, second = (complete(8, n_sources=1, n_mics=2)[1] for _ in range(2))
    assert first == second


def test_likelihood_of_a_geometry_that_the_arrivals_do_not_support_has_mean_one():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(4000)
    noise[50] = 100.0
    ratio = measure_arrivals(noise).ratio
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.02)


def test_likelihood_counts_a_reflection_at_its_image():
    dims, source, mic = np.array([[5.0, 4.0, 3.0]]), np.array([[1.0, 1.5, 1.2]]), np.array([[3.5, 2.0, 1.4]])
    floor_m = np.linalg.norm(source - mic * [1, 1, -1])
    sample = (floor_m - np.linalg.norm(source - mic)) / 343.0 * 16000
    ratio = np.ones(720)
    ratio[int(sample):int(sample) + 2] = 9.0
    of_walls = np.full((1, 6), 1e-9)
    of_walls[0, 4] = 0.5
    found = log_likelihood(ratio, dims, np.array([343.0]), source, mic, early_images()[0], heard_probability(of_walls))
    assert found[0] == pytest.approx(np.log(0.5 + 0.5 * 9.0), rel=1e-6)


def test_annealing_samples_both_modes_of_a_posterior():
    rng = np.random.default_rng(2)
    particles = rng.standard_normal((1000, 2))
    samples = anneal(particles, lambda x: -0.5 * np.sum(x ** 2, axis=1),
                     lambda x, data: -0.5 * ((np.abs(x[:, data[:1]]) - 1.0) / 0.05) ** 2,
                     [Block(np.array([0]), np.array([0])), Block(np.array([1]), np.array([0]))],
                     [lambda x: x * [-1.0, 1.0]], 1, rng)
    assert np.mean(samples[:, 0] > 0.0) == pytest.approx(0.5, abs=0.05)
    assert np.mean(np.abs(samples[:, 0])) == pytest.approx(1.0, abs=0.02)
    assert np.std(samples[:, 1]) == pytest.approx(1.0, abs=0.1)
