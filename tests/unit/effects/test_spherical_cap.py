"""The directivity of a cap on a sphere against known limits and its own power."""

import numpy as np
import pytest
from scipy.special import eval_legendre, j1

from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.spherical_cap import MAX_RADIUS_M, SPEED_M_S, cap_gain, cap_series

NODE, WEIGHT = np.polynomial.legendre.leggauss(600)
CABINETS = [(0.1, 0.4), (0.15, 0.5), (0.1, 0.8), (0.3, 0.1)]  # radius [m], half-angle [rad]


def cap_spectrum(cos_angle, radius_m, cap_rad, frequencies_hz):
    """Sum the series at single frequencies: pressure relative to the axis, shape (..., n_frequencies).

    Phases are those of numpy's FFT; the delay is that from the centre of the sphere less that on the axis.
    """
    coefficients = cap_series(radius_m, cap_rad, frequencies_hz)
    legendre = eval_legendre(np.arange(coefficients.shape[1]), np.asarray(cos_angle, dtype=float)[..., None])
    return (legendre @ coefficients.T / coefficients.sum(axis=1)).conj()


def frequency_hz(ka, radius_m):
    return np.atleast_1d(ka) * SPEED_M_S / (2.0 * np.pi * radius_m)


@pytest.mark.parametrize("radius_m, cap_rad", CABINETS)
def test_gain_on_axis_is_one(radius_m, cap_rad):
    np.testing.assert_allclose(cap_gain(1.0, radius_m, cap_rad), 1.0, rtol=1e-12)
    np.testing.assert_allclose(cap_spectrum([1.0], radius_m, cap_rad, EXACT_BANDS_HZ), 1.0 + 0j, rtol=1e-12)


@pytest.mark.parametrize("radius_m, cap_rad", CABINETS)
def test_small_sphere_is_omnidirectional(radius_m, cap_rad):
    pressure = cap_spectrum(NODE, radius_m, cap_rad, frequency_hz(0.05, radius_m))
    np.testing.assert_allclose(20.0 * np.log10(np.abs(pressure)), 0.0, atol=0.1)


def test_point_source_on_small_sphere_is_monopole_plus_dipole():
    """To first order in ka the pressure is ``1 - (3/2) i ka (1 - cos)``, the delay around a rigid sphere (Rayleigh)."""
    ka, cosine = 0.02, np.array([1.0, 0.5, 0.0, -1.0])
    pressure = cap_spectrum(cosine, 0.1, 1e-3, frequency_hz(ka, 0.1))[:, 0]
    np.testing.assert_allclose(pressure, 1.0 - 1.5j * ka * (1.0 - cosine), atol=5.0 * ka ** 2)


@pytest.mark.parametrize("radius_m, cap_rad", CABINETS[:2])
@pytest.mark.parametrize("kb, tolerance", [(3.0, 0.06), (4.0, 0.02), (6.0, 0.03), (8.0, 0.02)])
def test_main_lobe_is_that_of_a_piston_in_a_baffle(radius_m, cap_rad, kb, tolerance):
    """The pressure relative to the axis agrees up to 60 degrees where the membrane is not small."""
    angle = np.radians(np.arange(1.0, 61.0))
    x = kb * np.sin(angle)
    pressure = np.abs(cap_spectrum(np.cos(angle), radius_m, cap_rad, frequency_hz(kb, radius_m * np.sin(cap_rad))))
    np.testing.assert_allclose(pressure[:, 0], np.abs(2.0 * j1(x) / x), atol=tolerance)


@pytest.mark.parametrize("radius_m, cap_rad", CABINETS)
def test_power_over_directions_equals_that_of_the_series(radius_m, cap_rad):
    coefficients = cap_series(radius_m, cap_rad, np.geomspace(50.0, 11000.0, 40))
    power = np.sum(np.abs(coefficients) ** 2 / (2 * np.arange(coefficients.shape[1]) + 1), axis=1)
    pressure = cap_spectrum(NODE, radius_m, cap_rad, np.geomspace(50.0, 11000.0, 40))
    share = power / np.abs(coefficients.sum(axis=1)) ** 2
    np.testing.assert_allclose(0.5 * WEIGHT @ np.abs(pressure) ** 2, share, rtol=1e-9)


@pytest.mark.parametrize("radius_m, cap_rad", CABINETS)
def test_directivity_index_grows_with_frequency(radius_m, cap_rad):
    index_db = -10.0 * np.log10(0.5 * WEIGHT @ cap_gain(NODE, radius_m, cap_rad))
    assert np.all(np.diff(index_db) > 0.0)
    assert index_db[0] < 0.5 and index_db[-1] > 3.0


def test_band_gain_is_the_mean_over_its_frequencies_up_to_half_the_sample_rate():
    cosine = np.linspace(-1.0, 1.0, 41)
    for band, middle_hz in enumerate(EXACT_BANDS_HZ):
        frequencies_hz = middle_hz * 2.0 ** np.linspace(-0.5, 0.5, 400)
        frequencies_hz = frequencies_hz[frequencies_hz < 0.5 * FS_HZ]
        exact = np.mean(np.abs(cap_spectrum(cosine, 0.12, 0.6, frequencies_hz)) ** 2, axis=1)
        np.testing.assert_allclose(cap_gain(cosine, 0.12, 0.6)[:, band], exact, rtol=0.03, atol=1e-4)


def test_result_shape_follows_the_directions():
    cosine = np.linspace(-1.0, 1.0, 6).reshape(2, 3)
    gain = cap_gain(cosine, 0.1, 0.4)
    assert gain.shape == (2, 3, 8)
    np.testing.assert_array_equal(gain[1, 0], cap_gain(cosine[1, 0], 0.1, 0.4))
    assert cap_gain([1.0 + 1e-12, -1.0 - 1e-12], 0.1, 0.4).shape == (2, 8)  # rounding of a scalar product


@pytest.mark.parametrize("step", [(1e-6, 0.0), (0.0, 1e-5)])
def test_gains_are_smooth_in_the_parameters(step):
    """Central differences over two step sizes agree, as least squares requires."""
    cosine = np.linspace(-1.0, 1.0, 101)

    def slope(factor):
        ahead, back = (10.0 * np.log10(cap_gain(cosine, 0.13 + sign * factor * step[0], 0.5 + sign * factor * step[1]))
                       for sign in (1.0, -1.0))
        return (ahead - back) / (2.0 * factor * max(step))

    np.testing.assert_allclose(slope(1.0), slope(30.0), rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("radius_m, cap_rad, match", [
    (0.0, 0.4, "radius_m=0 "), (1.01 * MAX_RADIUS_M, 0.4, "radius_m="), (np.nan, 0.4, "radius_m=nan"),
    (0.1, 0.0, "cap_rad=0 "), (0.1, 1.6, r"cap_rad=1\.6 ")])
def test_parameters_out_of_range_raise_value_error(radius_m, cap_rad, match):
    with pytest.raises(ValueError, match=match):
        cap_gain([0.5], radius_m, cap_rad, [1000.0])
