"""How the loop decides: steps of a fit, whether an effect helps, and what one room alone leaves unexplained."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.constants import BANDS_HZ
from roomeq.effects.sound_speed import SoundSpeed
from roomeq.loop.attribute import Candidate
from roomeq.loop.cells import N_CELLS, slots
from roomeq.loop.fit import _step
from roomeq.loop.unexplained import find_unexplained


@pytest.mark.parametrize("to, expected", [(1.0, 1.0), (3.0, 1.5), (9.0, 1.8), (-1.0, 0.0)])
def test_a_step_goes_as_far_as_it_helps(to, expected):
    mean, local = _step(lambda mean, local: (mean[0] - 1.1) ** 2, 1.1 ** 2, (np.zeros(1), [np.zeros(2)]),
                        (np.array([to]), [np.array([to, 2.0 * to])]))
    assert mean[0] == pytest.approx(expected)
    np.testing.assert_allclose(local[0], [expected, 2.0 * expected])


@pytest.mark.parametrize("gain, size_jnd, helps", [
    ([1.1, 3.4, 7.7, -0.7, 1.4, -0.4, 7.1, -0.2], 1.5, True),  # some rooms tell little
    ([0.7, 0.1, -0.1, 0.1, -0.5, 0.1, 12.0, 0.3], 1.5, False),  # one room alone
    ([0.5, 0.6, 0.4, 0.5, 0.6, 0.5, 0.4, 0.6], 1.5, False),  # all a little, together too little for 11 candidates
    ([5.0] * 8, 0.4, False),  # nobody would hear it
    ([-1.0] * 8, 1.5, False)])
def test_an_effect_helps_by_what_all_rooms_gain_without_the_best(gain, size_jnd, helps):
    assert Candidate(SoundSpeed, None, np.array(gain), size_jnd).helps(11) == helps


@pytest.mark.parametrize("extra_jnd", [0.0, 6.0])
def test_a_residual_of_one_room_is_unexplained_if_the_others_make_it_unlikely(extra_jnd):
    rng = np.random.default_rng(1)
    room = np.repeat(np.arange(8), 8)
    residual = rng.normal(0.0, 0.7, (64, N_CELLS)) + rng.normal(0.0, 0.3, (8, N_CELLS))[room]
    residual[room == 5, slots("t30").start + 3] += extra_jnd
    data = SimpleNamespace(room=room, room_names=list("abcdefgh"), units=lambda scope: (["one"], np.zeros(64, int)))
    found = find_unexplained(SimpleNamespace(data=data, residual=residual))
    if extra_jnd:
        assert (found[0].metric, found[0].varies_with, found[0].bands_hz) == ("t30", "room", [BANDS_HZ[3]])
        assert found[0].size_jnd == pytest.approx(extra_jnd, abs=1.0)
    assert len(found) == (extra_jnd > 0.0)
