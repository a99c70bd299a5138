"""RIRs are cut for toolkits that advance speech by nothing, or by the position of the largest sample."""

import numpy as np
import pytest
from datadirs import FS, decay

from roomeq.acoustics.subband_eq import analyse
from roomeq.eq.compensation import compensate_rir
from roomeq.export.align import LEAD_S, align

LEAD = round(LEAD_S * FS)


@pytest.mark.parametrize("direct", [0, 3, LEAD, 100, 3999])
def test_direct_sound_comes_after_the_lead(direct):
    h = decay(np.random.default_rng(direct), direct=direct)
    samples = align(h, direct, FS, positive=False).samples
    assert samples[LEAD] == h[direct]
    np.testing.assert_array_equal(samples[LEAD:], h[direct:])
    assert len(samples) == len(h) - direct + LEAD


@pytest.mark.parametrize("rate_hz", [8000, 44100, 48000])
def test_lead_is_a_time_not_a_number_of_samples(rate_hz):
    h = decay(np.random.default_rng(0), direct=500)
    assert align(h, 500, rate_hz, positive=False).samples[round(LEAD_S * rate_hz)] == h[500]


@pytest.mark.parametrize("direct", [100, 300, 600])
@pytest.mark.parametrize("target_db", [[9, 6, 3, 0, 0, -2, -4, -8], [-12, -8, -4, 0, 0, 0, 0, 0],
                                       [6, -6, 6, -3, 0, -3, -6, -10]])
def test_compensated_rir_keeps_its_eq(direct, target_db):
    """Half of a filter of linear phase lies ahead of the direct sound."""
    compensated = compensate_rir(decay(np.random.default_rng(0), direct=direct), direct, target_db).samples
    aligned = align(compensated, direct, FS, positive=False).samples
    np.testing.assert_allclose(analyse(aligned, LEAD).eq_db, target_db, atol=1.0)  # the just noticeable difference


def test_negative_direct_sound_is_inverted_only_on_request():
    h = decay(np.random.default_rng(1), direct=200, level=-1.0)
    assert align(h, 200, FS, positive=False).samples[LEAD] == -1.0
    inverted = align(h, 200, FS, positive=True)
    assert inverted.samples[LEAD] == 1.0
    assert inverted.late_s == 0.0


def test_stronger_reflection_is_told_by_its_delay():
    h = decay(np.random.default_rng(2), direct=200)
    h[200 + 320], h[200 + 330] = 1.5, -1.4
    assert align(h, 200, FS, positive=True).late_s == pytest.approx(0.02)


def test_stronger_reflection_of_other_polarity_leaves_the_rir_alone():
    h = decay(np.random.default_rng(3), direct=200)
    h[200 + 320] = -1.5
    aligned = align(h, 200, FS, positive=True)
    assert aligned.late_s == 0.0
    assert aligned.samples[LEAD] == 1.0
