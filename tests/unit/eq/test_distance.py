"""Distances between EQ distributions: identity, shifts, room weighting, the gap closed."""

import numpy as np
import pytest
from scipy.stats import binom

from roomeq.eq.distance import EqSet, eq_distance, gap_closed


def rng():
    return np.random.default_rng(0)


def one_room(vectors_db, room="a"):
    return EqSet(vectors_db, [room] * len(vectors_db))


@pytest.fixture
def vectors():
    return rng().normal(0.0, 3.0, (200, 7))


def test_distance_of_a_set_from_itself_is_zero(vectors):
    distance = eq_distance(one_room(vectors), one_room(vectors), rng(), n_bootstrap=5)
    assert distance["wasserstein_db"] == pytest.approx(0.0, abs=1e-12)
    assert distance["energy_db"] == pytest.approx(0.0, abs=1e-6)


def drawn_sets(generator, true_db, n_rooms, shared_rooms):
    """Return two sets of 8 RIRs a room whose distributions lie `true_db` apart."""
    def drawn(rooms_db, shift_db):
        return np.concatenate([room_db + shift_db + generator.normal(0.0, 2.0, (8, 7)) for room_db in rooms_db])

    rooms_db = generator.normal(0.0, 2.0, (2, n_rooms, 7))
    names = np.repeat(np.arange(n_rooms), 8)
    return (EqSet(drawn(rooms_db[0], 0.0), names),
            EqSet(drawn(rooms_db[0 if shared_rooms else 1], true_db), names if shared_rooms else names + n_rooms))


@pytest.mark.parametrize("true_db", [0.0, 0.5, 3.0])
@pytest.mark.parametrize(("n_rooms", "shared_rooms"), [(4, False), (8, True), (12, False)])
def test_intervals_cover_the_true_distance(true_db, n_rooms, shared_rooms):
    generator = np.random.default_rng(n_rooms)
    covered = []
    for _ in range(60):
        distance = eq_distance(*drawn_sets(generator, true_db, n_rooms, shared_rooms), generator, n_bootstrap=50)
        low, high = distance["interval_db"]
        assert low <= distance["wasserstein_db"] <= high
        covered.append(low <= true_db <= high)
    assert np.mean(covered) >= 0.9  # nominally 95 %


def test_intervals_of_equal_distributions_begin_at_zero():
    generator = np.random.default_rng(0)
    distances = [eq_distance(*drawn_sets(generator, 0.0, 6, False), generator, n_bootstrap=80) for _ in range(50)]
    assert min(distance["wasserstein_db"] for distance in distances) > 0.5  # the bias of finite sets
    for name in ("interval_db", "energy_interval_db"):
        assert np.mean([distance[name][0] == 0.0 for distance in distances]) >= 0.9


def test_interval_of_a_set_and_itself_is_zero():
    few = np.random.default_rng(1).normal(0.0, 3.0, (24, 7))
    rooms = [f"r{n % 6}" for n in range(24)]
    distance = eq_distance(EqSet(few, rooms), EqSet(few, rooms), np.random.default_rng(2), n_bootstrap=100)
    assert distance["wasserstein_db"] == 0.0 and distance["interval_db"] == [0.0, 0.0]


def test_distance_of_a_shifted_set_is_the_shift(vectors):
    shift_db = np.array([7.0, 0.0, 0.0, 0.0, -3.5, 0.0, 0.0])
    distance = eq_distance(one_room(vectors), one_room(vectors + shift_db), rng(), n_bootstrap=5)
    assert distance["bands_db"] == pytest.approx(np.abs(shift_db))
    assert distance["wasserstein_db"] == pytest.approx(1.5)


def test_energy_distance_of_two_points_is_known():
    # the root of 2 |x - y| - 0 - 0
    distance = eq_distance(one_room(np.zeros((1, 7))), one_room(np.full((1, 7), 2.0), "b"), rng(), n_bootstrap=2)
    assert distance["energy_db"] == pytest.approx(np.sqrt(2 * 2 * np.sqrt(7)))


def test_rooms_weigh_the_same_whatever_their_size():
    # 190 RIRs of one room and 10 of another: the second room is half of the distribution
    uneven = EqSet(np.concatenate([np.zeros((190, 7)), np.full((10, 7), 4.0)]), ["a"] * 190 + ["b"] * 10)
    distance = eq_distance(uneven, one_room(np.zeros((50, 7)), "c"), rng(), n_bootstrap=5)
    assert distance["wasserstein_db"] == pytest.approx(2.0)


def test_unmeasured_points_are_left_out(vectors):
    incomplete = vectors.copy()
    incomplete[::2, 0] = np.nan
    distance = eq_distance(one_room(incomplete), one_room(vectors), rng(), n_bootstrap=5)
    assert 0.0 < distance["bands_db"][0] < 1.0
    assert distance["bands_db"][1:] == pytest.approx([0.0] * 6, abs=1e-12)
    assert np.isfinite(distance["energy_db"])


def test_interval_contains_distance_and_widens_with_rooms(vectors):
    reference = EqSet(rng().normal(1.0, 3.0, (200, 7)), [f"b{n}" for n in range(200)])
    rooms = [f"r{n // 50}" for n in range(200)]
    by_room = vectors + np.repeat(rng().normal(0.0, 4.0, (4, 7)), 50, axis=0)
    many = eq_distance(EqSet(by_room, [f"r{n}" for n in range(200)]), reference, rng(), n_bootstrap=200)
    clustered = eq_distance(EqSet(by_room, rooms), reference, rng(), n_bootstrap=200)
    assert many["interval_db"][0] < many["wasserstein_db"] < many["interval_db"][1]
    assert np.ptp(clustered["interval_db"]) > 2 * np.ptp(many["interval_db"])


@pytest.mark.parametrize(("n_rooms", "shared_rooms"), [(1, False), (1, True), (2, False), (2, True)])
def test_one_or_two_rooms_show_no_difference_of_sets(n_rooms, shared_rooms):
    generator = np.random.default_rng(n_rooms)
    few, others = drawn_sets(generator, 0.0, n_rooms, shared_rooms)
    many, _ = drawn_sets(generator, 0.0, 5, False)
    for first, second in ((few, others), (few, many), (many, few)):
        distance = eq_distance(first, second, generator, n_bootstrap=10)
        assert distance["wasserstein_db"] > 0.0
        assert distance["interval_db"] is None and distance["energy_interval_db"] is None
    far = EqSet(many.vectors_db + 9.0, np.repeat(np.arange(5), 8))
    gap = gap_closed(far, many, many, few, generator, n_bootstrap=10)
    assert gap["closed"] is not None and gap["closed_interval"] is None


def test_gap_closed_is_none_half_or_all():
    def drawn(seed, shift):
        return EqSet(np.random.default_rng(seed).normal(shift, 2.0, (400, 7)), [f"r{n % 10}" for n in range(400)])

    heldout, train, sim = drawn(0, 0.0), drawn(1, 0.0), drawn(2, 6.0)
    for comp, low, high in ((drawn(3, 0.0), 0.97, 1.03), (drawn(4, 3.0), 0.4, 0.6), (sim, 0.0, 0.0)):
        gap = gap_closed(sim, comp, train, heldout, rng(), n_bootstrap=20)
        assert low - 1e-9 <= gap["closed"] <= high + 1e-9
        assert gap["closed_interval"][0] <= gap["closed"] + 0.05


@pytest.mark.parametrize(("n_rooms", "left_db"), [(10, 0.0), (10, 1.5), (6, 3.0)])
def test_interval_of_the_closed_gap_covers_the_share_of_the_expected_distances(n_rooms, left_db):
    """Of RIRs 3 dB off, of which compensation leaves some; the measured training RIRs are in the held-out rooms."""
    generator = np.random.default_rng(n_rooms)
    names = np.repeat(np.arange(n_rooms), 6)

    def drawn(shift_db, rooms_db=None):
        rooms_db = generator.normal(0.0, 2.0, (n_rooms, 7)) if rooms_db is None else rooms_db
        return EqSet(np.repeat(rooms_db, 6, axis=0) + shift_db + generator.normal(0.0, 1.5, (6 * n_rooms, 7)), names)

    gaps = []
    for _ in range(120):
        rooms_db = generator.normal(0.0, 2.0, (n_rooms, 7))
        gaps.append(gap_closed(drawn(3.0), drawn(left_db), drawn(0.0, rooms_db), drawn(0.0, rooms_db), generator,
                               n_bootstrap=60))
    sim, comp, floor = (np.mean([gap[name]["wasserstein_db"] for gap in gaps]) for name in ("sim", "comp", "floor"))
    share = (sim - comp) / (sim - floor)
    intervals = [gap["closed_interval"] for gap in gaps if gap["closed_interval"]]
    assert len(intervals) > 100
    assert sum(low <= share <= high for low, high in intervals) >= binom.ppf(0.01, len(intervals), 0.93)
    assert sum(share < low for low, _ in intervals) <= binom.ppf(0.99, len(intervals), 0.04)


def test_uncertain_gap_has_no_interval_of_the_share():
    generator = np.random.default_rng(3)
    gaps = []
    for _ in range(30):  # all of one population
        (sim, comp), (train, heldout) = (drawn_sets(generator, 0.0, 4, False) for _ in range(2))
        gaps.append(gap_closed(sim, comp, train, heldout, generator, n_bootstrap=50))
    assert sum(gap["closed"] is not None for gap in gaps) > 8
    assert sum(gap["closed_interval"] is not None for gap in gaps) <= 3


def test_gap_closed_is_null_where_there_is_no_gap(vectors):
    near, train = one_room(vectors), one_room(vectors + 1.0)
    assert gap_closed(near, near, train, near, rng(), n_bootstrap=2)["closed"] is None


@pytest.mark.parametrize("vectors, rooms", [
    (np.zeros((0, 7)), []), (np.zeros((3, 7)), ["a"]), (np.zeros(7), ["a"] * 7)])
def test_empty_or_unmatched_sets_are_refused(vectors, rooms):
    with pytest.raises(ValueError, match="EQ vectors of shape .* a room for each"):
        EqSet(vectors, rooms)
