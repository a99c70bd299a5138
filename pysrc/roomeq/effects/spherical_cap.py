"""Directivity of a membrane in a rigid sphere: a loudspeaker in its cabinet, with two parameters.

A cap of half-angle ``cap_rad`` on a sphere of radius ``radius_m`` moves; the rest of the sphere is at rest. In the far
field (Morse and Ingard, Theoretical Acoustics, 1968, sec. 7.2; time dependence ``exp(-i omega t)``)

    p(theta) ~ sum_n c_n P_n(cos theta),  c_n = (-i)^n U_n / h_n'(k a),  U_n = (2 n + 1) / 2 int u P_n d(cos theta).

There all points of the cap move in phase. On the axis, sound from the rim then arrives late by the depth of the cap,
and where that depth is near a wavelength it cancels the sound from the centre, which no flat membrane does. Here the
cap moves like a plane wave that passes through it, ``u = exp(i k a (cos theta - 1))``. The two agree where the depth is
short against a wavelength. The plane wave is never zero on the axis, and its main lobe is as narrow as that of a piston
in a baffle where that model holds.

All gains are relative to the axis: the gain on the axis is the loudspeaker's response, another effect. The radius of
the sphere sets the frequency above which the cabinet casts a shadow, that of the membrane, ``radius_m sin(cap_rad)``,
the width of the main lobe.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import eval_legendre

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.core.jit import compiled

MAX_RADIUS_M = 0.5
SPEED_M_S = speed_of_sound_m_s(20.0)  # a change by 10 degrees is equivalent to one of the radius by 2 %
_PER_BAND = 12  # frequencies over which a band is averaged
_STEP = 32  # polynomials are cached for multiples of this number of terms
_ANGLES_PER_TERM = 16  # of a table: the finest fringe of the energy spans as many of its angles


def cap_gain(cos_angle: ArrayLike, radius_m: float, cap_rad: float,
             bands_hz: Sequence[float] = EXACT_BANDS_HZ, fs_hz: float = FS_HZ) -> FloatArray:
    """Return the energy relative to the axis, averaged over octave bands, up to half the sample rate.

    Parameters
    ----------
    cos_angle : array_like
        Cosine of the angle between the axis and a direction.
    radius_m : float
        Of the sphere, up to `MAX_RADIUS_M`.
    cap_rad : float
        Half-angle of the cap, up to pi / 2.
    bands_hz : sequence of float
        Mid-band frequencies.
    fs_hz : float
        Sample rate.

    Returns
    -------
    gain : ndarray, shape (..., n_bands)

    Raises
    ------
    ValueError
        A parameter is out of range.
    """
    return look_up(cos_angle, cap_table(float(radius_m), float(cap_rad), tuple(bands_hz), fs_hz))


def look_up(cos_angle: ArrayLike, table: FloatArray) -> FloatArray:
    """Interpolate between the angles of a table (`cap_table`), for cosines of shape (...,): shape (..., n_bands)."""
    cos_angle = np.asarray(cos_angle, dtype=float)
    gain = np.empty((cos_angle.size, table.shape[1]))
    _interpolate(np.ravel(cos_angle), table, gain)
    return gain.reshape(*cos_angle.shape, table.shape[1])


def cap_series(radius_m: float, cap_rad: float, frequencies_hz: ArrayLike) -> Array:
    """Return the coefficients ``c_n`` of the Legendre series of the far field.

    The mean of ``|p|^2`` over all directions is ``sum_n |c_n|^2 / (2 n + 1)``, and ``p = sum_n c_n`` on the axis.

    Parameters
    ----------
    radius_m, cap_rad : float
    frequencies_hz : array_like, shape (n_frequencies,)

    Returns
    -------
    coefficients : ndarray of complex, shape (n_frequencies, n_terms)

    Raises
    ------
    ValueError
        A parameter is out of range.
    """
    if not 0.0 < radius_m <= MAX_RADIUS_M:
        raise ValueError(f"radius_m={radius_m:g} of the sphere must lie in (0, {MAX_RADIUS_M:g}] m: correct it")
    if not 0.0 < cap_rad <= 0.5 * np.pi:
        raise ValueError(f"cap_rad={cap_rad:g} must lie in (0, pi / 2]: correct the half-angle of the cap")
    ka = 2.0 * np.pi * np.asarray(frequencies_hz, dtype=float) / SPEED_M_S * radius_m
    radiated = _radiated(tuple(np.ravel(ka)))
    n = np.arange(radiated.shape[1])
    node, weight = _gauss_legendre(_STEP * (len(n) // _STEP + 1))
    depth = 0.5 * (1.0 - np.cos(cap_rad)) * (1.0 - node)  # of points of the cap below its centre, in radii
    velocity = (np.exp(-1j * np.outer(ka, depth)) * weight) @ eval_legendre(n, 1.0 - depth[:, None])
    return velocity * radiated


@lru_cache(maxsize=64)
def _radiated(ka: tuple[float, ...]) -> Array:
    """Return the factors ``(2 n + 1) (-i)^n / h_n'(k a)`` of the series, shape (n_frequencies, n_terms)."""
    n, x = np.arange(int(1.1 * max(ka)) + 25), np.array(ka)  # higher terms are below 1e-9
    with np.errstate(over="ignore", invalid="ignore"):
        slope = _derivative(_spherical_hankel(len(n), x), x)
        # high orders at low ka do not radiate
        return (2 * n + 1) * (-1j) ** n * np.where(np.isfinite(slope), 1.0 / slope, 0.0)


def _spherical_hankel(n_orders: int, x: FloatArray) -> Array:
    """Spherical Hankel functions of the first kind, shape (n, n_orders), infinite where they are too large.

    The recurrence over orders (DLMF 10.51.1) is stable for them, and ten times as fast as scipy's functions, which
    compute each order on its own.
    """
    values = np.empty((n_orders, len(x)), dtype=complex)
    values[0] = -1j * np.exp(1j * x) / x
    values[1] = (1.0 / x - 1j) * values[0]
    for n in range(1, n_orders - 1):
        values[n + 1] = (2 * n + 1) / x * values[n] - values[n - 1]
    return values.T


def _derivative(bessel: Array, x: FloatArray) -> Array:
    """Derivatives of spherical Bessel functions of orders 0 and up, shape (n, n_orders) (DLMF 10.51.2)."""
    n = np.arange(1, bessel.shape[1])
    return np.column_stack([-bessel[:, 1], bessel[:, :-1] - (n + 1) * bessel[:, 1:] / x[:, None]])


@lru_cache(maxsize=8)
def _gauss_legendre(n_nodes: int) -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(n_nodes)


@lru_cache(maxsize=4)
def _polynomials(n_terms: int) -> FloatArray:
    """Legendre polynomials at the angles of a table, shape (n_terms, n_angles)."""
    return eval_legendre(np.arange(n_terms)[:, None], np.cos(table_angles(_ANGLES_PER_TERM * n_terms + 1)))


def table_angles(n_angles: int) -> FloatArray:
    """Return the angles of a table [rad]."""
    return np.linspace(0.0, np.pi, n_angles)


@lru_cache(maxsize=64)
def cap_table(radius_m: float, cap_rad: float, bands_hz: tuple[float, ...] = EXACT_BANDS_HZ,
              fs_hz: float = FS_HZ) -> FloatArray:
    """Return the gain of `cap_gain` at `table_angles`, shape (n_angles, n_bands)."""
    octaves = np.minimum(np.log2(0.5 * fs_hz / np.array(bands_hz)), 0.5) + 0.5  # half of the highest band is recorded
    frequencies_hz = np.array(bands_hz) * 2.0 ** (octaves * (np.arange(_PER_BAND)[:, None] + 0.5) / _PER_BAND - 0.5)
    coefficients = cap_series(radius_m, cap_rad, frequencies_hz.T.ravel())
    n_terms = coefficients.shape[1]
    polynomials = _polynomials(_STEP * (n_terms // _STEP + 1))[:n_terms]
    relative = coefficients / coefficients.sum(axis=1, keepdims=True)
    energy = (relative.real @ polynomials) ** 2 + (relative.imag @ polynomials) ** 2
    return np.ascontiguousarray(energy.reshape(len(bands_hz), _PER_BAND, -1).mean(axis=1).T)


@compiled
def _interpolate(cos_angle: FloatArray, table: FloatArray, gain: FloatArray) -> None:
    """Interpolate between the angles of a table, into `gain`."""
    last = len(table) - 1
    for n in range(len(cos_angle)):
        place = np.arccos(min(max(cos_angle[n], -1.0), 1.0)) * (last / np.pi)
        row = min(int(place), last - 1)
        share = place - row
        for band in range(gain.shape[1]):
            gain[n, band] = table[row, band] * (1.0 - share) + table[row + 1, band] * share
