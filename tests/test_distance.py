"""Distances between EQ distributions: identity, shifts, room weighting, the gap closed."""

import numpy as np
import pytest

from roomeq.eq.distance import eq_distance, gap_closed


def rng():
    return np.random.default_rng(0)


@pytest.fixture
def vectors():
    return rng().normal(0.0, 3.0, (200, 7))


def test_a_set_is_at_no_distance_from_itself(vectors):
    found = eq_distance(vectors, vectors, ["a"] * 200, ["a"] * 200, rng(), n_bootstrap=5)
    assert found["wasserstein_db"] == pytest.approx(0.0, abs=1e-12)
    assert found["energy_db"] == pytest.approx(0.0, abs=1e-6)


def test_intervals_are_not_shifted_by_resampling():
    few = np.random.default_rng(1).normal(0.0, 3.0, (24, 7))
    rooms = [f"r{n % 6}" for n in range(24)]
    found = eq_distance(few, few, rooms, rooms, np.random.default_rng(2), n_bootstrap=100)
    assert found["wasserstein_db"] == 0.0 and found["interval_db"] == [0.0, 0.0]
    found = eq_distance(few, few + 2.0, rooms, rooms, np.random.default_rng(2), n_bootstrap=200)
    assert found["interval_db"][0] <= found["wasserstein_db"] <= found["interval_db"][1]


def test_a_shift_is_the_distance(vectors):
    shift_db = np.array([7.0, 0.0, 0.0, 0.0, -3.5, 0.0, 0.0])
    found = eq_distance(vectors, vectors + shift_db, ["a"] * 200, ["a"] * 200, rng(), n_bootstrap=5)
    assert found["bands_db"] == pytest.approx(np.abs(shift_db))
    assert found["wasserstein_db"] == pytest.approx(1.5)


def test_energy_distance_of_two_points_is_known():
    # 2 |x - y| - 0 - 0, and its root
    found = eq_distance(np.zeros((1, 7)), np.full((1, 7), 2.0), ["a"], ["b"], rng(), n_bootstrap=2)
    assert found["energy_db"] == pytest.approx(np.sqrt(2 * 2 * np.sqrt(7)))


def test_rooms_count_equally(vectors):
    # 190 RIRs of one room and 10 of another: the other is half of the distribution
    one = np.concatenate([np.zeros((190, 7)), np.full((10, 7), 4.0)])
    found = eq_distance(one, np.zeros((50, 7)), ["a"] * 190 + ["b"] * 10, ["c"] * 50, rng(), n_bootstrap=5)
    assert found["wasserstein_db"] == pytest.approx(2.0)


def test_points_that_were_not_measured_are_left_out(vectors):
    holes = vectors.copy()
    holes[::2, 0] = np.nan
    found = eq_distance(holes, vectors, ["a"] * 200, ["a"] * 200, rng(), n_bootstrap=5)
    assert 0.0 < found["bands_db"][0] < 1.0 and found["bands_db"][1:] == pytest.approx([0.0] * 6, abs=1e-12)
    assert np.isfinite(found["energy_db"])


def test_interval_holds_the_distance_and_is_wider_with_rooms(vectors):
    other = rng().normal(1.0, 3.0, (200, 7))
    rooms = [f"r{n // 50}" for n in range(200)]
    by_room = vectors + np.repeat(rng().normal(0.0, 4.0, (4, 7)), 50, axis=0)
    single = eq_distance(by_room, other, ["a"] * 200, ["b"] * 200, rng(), n_bootstrap=200)
    clustered = eq_distance(by_room, other, rooms, ["b"] * 200, rng(), n_bootstrap=200)
    assert single["interval_db"][0] < single["wasserstein_db"] < single["interval_db"][1]
    assert np.ptp(clustered["interval_db"]) > 2 * np.ptp(single["interval_db"])


def test_gap_closed_is_none_all_or_part():
    def drawn(seed, shift):
        return np.random.default_rng(seed).normal(shift, 2.0, (400, 7))

    rooms = [f"r{n % 10}" for n in range(400)]
    heldout, train, sim = drawn(0, 0.0), drawn(1, 0.0), drawn(2, 6.0)
    for comp, low, high in ((drawn(3, 0.0), 0.97, 1.03), (drawn(4, 3.0), 0.4, 0.6), (sim, 0.0, 0.0)):
        found = gap_closed(sim, comp, train, heldout, rooms_sim=rooms, rooms_comp=rooms, rooms_train=rooms,
                           rooms_heldout=rooms, rng=rng(), n_bootstrap=20)
        assert low - 1e-9 <= found["closed"] <= high + 1e-9
        assert found["closed_interval"][0] <= found["closed"] + 0.05


def test_no_gap_is_said_by_none(vectors):
    rooms = ["a"] * 200
    found = gap_closed(vectors, vectors, vectors + 1.0, vectors, rooms_sim=rooms, rooms_comp=rooms,
                       rooms_train=rooms, rooms_heldout=rooms, rng=rng(), n_bootstrap=2)
    assert found["closed"] is None


@pytest.mark.parametrize("vectors, rooms", [
    (np.zeros((0, 7)), []), (np.zeros((3, 7)), ["a"]), (np.zeros(7), ["a"] * 7)])
def test_empty_or_unmatched_sets_are_refused(vectors, rooms):
    with pytest.raises(ValueError, match="the first set has vectors"):
        eq_distance(vectors, np.zeros((1, 7)), rooms, ["a"], rng(), n_bootstrap=2)
