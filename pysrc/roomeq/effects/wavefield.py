"""The low-frequency field of a room as a sum of its modes, crossed over to rays.

Below the Schroeder frequency a room responds at its eigenfrequencies, which ray tracing does not model. In a room with
rigid walls and small losses the impulse response is (Kuttruff, Room Acoustics, sec. 3.1 and 3.2; Green's function of
the wave equation)

    h(t) = c^2 / V sum_n psi_n(r) psi_n(r0) exp(-d_n t) sin(w_n t) / w_n,  mean of psi_n^2 over the room = 1.

It has the level of the simulator: the direct sound is ``delta(t - r / c) / (4 pi r)``.

To low frequencies, modes above those in the sum respond instantaneously. Together they contribute what the sum lacks
of the direct sound: ``(1 - 2 / pi Si(k_max r)) / (4 pi r)``, the part of ``1 / (4 pi r)`` with wave numbers above
k_max.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.special import sici

from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.core.jit import compiled
from roomeq.effects.prism import is_prism, prism_modes
from roomeq.effects.voxels import mode_count, voxel_modes
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.room import Room
from roomeq.sim.scene import Shoebox

MAX_CROSSOVER_HZ = 300.0
MAX_MODES = 1000  # of a shoebox or a prism, up to `MARGIN` times the crossover
MAX_MESH_MODES = 600  # of another mesh, where finding them takes 20 s
MARGIN = 1.5  # highest mode over the crossover frequency: modes above the crossover contribute below it
CROSSOVER_OCTAVES = 1.0
HIGHPASS_HZ = 15.0  # without it, the static pressure of a closed room never decays
_RINGING_S = 0.06  # the filters of the crossover ring for this time


@dataclass(frozen=True, eq=False)
class Modes:
    """The modes of a room, without the static one.

    Attributes
    ----------
    frequencies_hz : ndarray, shape (n_modes,)
        Ascending.
    f_max_hz : float
        Upper limit of the search.
    volume_m3, speed_m_s : float
    shapes : callable
        Maps a position, shape (3,) [m], to the pressure of each mode there, shape (n_modes,); the mean of its square
        over the room is 1.
    """

    frequencies_hz: FloatArray
    f_max_hz: float
    volume_m3: float
    speed_m_s: float
    shapes: Callable[[ArrayLike], FloatArray]


def modes(room: Room, f_max_hz: float, speed_m_s: float) -> Modes:
    """Find the modes of a room with rigid walls up to a frequency.

    Parameters
    ----------
    room : Shoebox or MeshRoom
        Cosines for a shoebox; for a mesh eigenmodes of a grid of voxels (`roomeq.effects.voxels`), which is flat if
        the mesh is a plan with a height (`roomeq.effects.prism`).
    f_max_hz, speed_m_s : float

    Raises
    ------
    ValueError
        A mesh needs too many voxels.
    """
    shapes: Callable[[ArrayLike], FloatArray]
    if isinstance(room, Shoebox):
        frequencies_hz, shapes = _cosines(room.dims_m, float(f_max_hz), float(speed_m_s))
    else:
        mesh, k_max = cast(MeshRoom, room), 2.0 * np.pi * f_max_hz / speed_m_s
        k, shapes = prism_modes(mesh, k_max) if is_prism(mesh) else voxel_modes(mesh, k_max)
        frequencies_hz = speed_m_s * k / (2.0 * np.pi)
    return Modes(frequencies_hz, float(f_max_hz), room.volume_m3, float(speed_m_s), shapes)


@lru_cache(maxsize=64)
def _cosines(dims_m: tuple[float, float, float], f_max_hz: float, speed_m_s: float) -> tuple[FloatArray, "Cosines"]:
    """Frequencies and shapes of the modes of a shoebox (Kuttruff, eq. 3.15 and 3.16)."""
    size_m = np.array(dims_m)
    counts = [np.arange(int(2.0 * f_max_hz * length_m / speed_m_s) + 1) for length_m in size_m]
    index = np.stack(np.meshgrid(*counts, indexing="ij"), axis=-1).reshape(-1, 3)[1:]
    frequencies_hz = 0.5 * speed_m_s * np.linalg.norm(index / size_m, axis=1)
    order = np.argsort(frequencies_hz, kind="stable")
    order = order[frequencies_hz[order] <= f_max_hz]
    return frequencies_hz[order], Cosines(size_m, index[order])


@dataclass(frozen=True, eq=False)
class Cosines:
    """Shapes of the modes of a shoebox.

    Attributes
    ----------
    dims_m : ndarray, shape (3,)
    index : ndarray of int, shape (n_modes, 3)
        Number of half-waves along x, y and z.
    """

    dims_m: FloatArray
    index: IntArray

    def __call__(self, position_m: ArrayLike) -> FloatArray:
        cosines = np.cos(np.pi * self.index * (np.asarray(position_m, dtype=float) / self.dims_m))
        return np.prod(cosines * np.where(self.index > 0, np.sqrt(2.0), 1.0), axis=1)


def damping_per_s(frequencies_hz: ArrayLike, t60_s: ArrayLike) -> FloatArray:
    """Return the damping at frequencies, ``3 ln(10) / T`` [1/s], interpolated between octaves over log frequency.

    Parameters
    ----------
    frequencies_hz : array_like
    t60_s : array_like, shape (8,)
        Per octave band.
    """
    return np.interp(np.log(frequencies_hz), np.log(EXACT_BANDS_HZ), 3.0 * np.log(10.0) / np.asarray(t60_s))


def modal_response(modes: Modes, source_pos_m: ArrayLike, mic_pos_m: ArrayLike, damping: ArrayLike, n_samples: int,
                   fs_hz: float) -> FloatArray:
    """Sum the modes to an impulse response.

    Parameters
    ----------
    modes : Modes
    source_pos_m, mic_pos_m : array_like, shape (3,)
    damping : float or array_like, shape (n_modes,)
        See `damping_per_s` [1/s].
    n_samples : int
    fs_hz : float

    Returns
    -------
    rir : ndarray, shape (n_samples,)
        Sample 0 is the emission. Accurate up to the frequency of the highest mode over `MARGIN`; a second-order
        Butterworth high-pass at `HIGHPASS_HZ` removes the static pressure.
    """
    distance_m = float(np.linalg.norm(np.subtract(source_pos_m, mic_pos_m)))
    omega = 2.0 * np.pi * modes.frequencies_hz
    damping = np.broadcast_to(damping, omega.shape)
    scale = modes.speed_m_s ** 2 / (modes.volume_m3 * fs_hz)
    weight = scale * (modes.shapes(source_pos_m) * modes.shapes(mic_pos_m)) / omega
    # exp(z (q L + r)) = exp(z q L) exp(z r): one matrix product computes all samples
    length = int(np.ceil(np.sqrt(n_samples)))
    pole = (-damping + 1j * omega) / fs_hz
    coarse, fine = weight * _powers(np.exp(length * pole), length), _powers(np.exp(pole), length)
    rir = (np.hstack([coarse.real, coarse.imag]) @ np.hstack([fine.imag, fine.real]).T).ravel()[:n_samples]
    # the static mode meets the walls as at grazing incidence: half the damping, first order
    rate = damping[0] if len(damping) else 1.0
    rir += scale * -np.expm1(-rate * np.arange(n_samples) / fs_hz) / rate
    missing = 1.0 - 2.0 / np.pi * sici(2.0 * np.pi * modes.f_max_hz / modes.speed_m_s * distance_m)[0]
    rir[0] += missing / (4.0 * np.pi * distance_m)
    return high_passed(rir, np.tan(np.pi * HIGHPASS_HZ / fs_hz))


def _powers(base: Array, n: int) -> Array:
    """Return the powers 0 to n - 1 of complex numbers, shape (n, len(base)), each from two lower ones."""
    powers = np.ones((n, len(base)), complex)
    known = 1
    while known < n:
        new = min(known, n - known)
        np.multiply(powers[:new], base, out=powers[known:known + new])
        known, base = known + new, base * base
    return powers


@compiled
def high_passed(signal: FloatArray, warped: float) -> FloatArray:
    """Filter by a Butterworth high-pass of second order, by its bilinear transform (direct form 2, transposed).

    `warped` is the tangent of half its angular frequency per sample. `scipy.signal` has the same filter, and takes most
    of a second to import.
    """
    scale = 1.0 + np.sqrt(2.0) * warped + warped ** 2
    first, second = 2.0 * (warped ** 2 - 1.0) / scale, (1.0 - np.sqrt(2.0) * warped + warped ** 2) / scale
    output, later, last = np.empty(len(signal)), 0.0, 0.0
    for n in range(len(signal)):
        sample = signal[n] / scale
        output[n] = sample + later
        later, last = -2.0 * sample - first * output[n] + last, sample - second * output[n]
    return output


def crossover_hz(room: Room, t60_s: ArrayLike, speed_m_s: float) -> float:
    """Return the crossover frequency to rays: the Schroeder frequency ``2000 sqrt(T / V)``, limited.

    It is at most `MAX_CROSSOVER_HZ`, and so low that there are no more than `MAX_MODES` or `MAX_MESH_MODES` up to
    `MARGIN` times it.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    t60_s : array_like, shape (8,)
        Per octave band.
    speed_m_s : float
    """
    return _crossover_hz(cast("Shoebox | MeshRoom", room), tuple(map(float, np.asarray(t60_s))), float(speed_m_s))


@lru_cache(maxsize=256)
def _crossover_hz(room: Shoebox | MeshRoom, t60_s: tuple[float, ...], speed_m_s: float) -> float:
    def above_schroeder(frequency_hz: float) -> float:  # T depends on frequency
        return frequency_hz - 2000.0 * np.sqrt(3.0 * np.log(10.0) / damping_per_s(frequency_hz, t60_s) / room.volume_m3)

    max_modes = MAX_MODES if isinstance(room, Shoebox) or is_prism(cast(MeshRoom, room)) else MAX_MESH_MODES

    def surplus_modes(frequency_hz: float) -> float:
        return mode_count(room, 2.0 * np.pi * MARGIN * frequency_hz / speed_m_s) - max_modes

    limits_hz = [scipy.optimize.brentq(surplus, 1e-3, MAX_CROSSOVER_HZ) for surplus in (above_schroeder, surplus_modes)
                 if surplus(MAX_CROSSOVER_HZ) > 0.0]
    return float(min(limits_hz, default=MAX_CROSSOVER_HZ))


def cross_over(low: FloatArray, high: FloatArray, fs_hz: float, frequency_hz: float,
               arrival_s: float = 0.0) -> FloatArray:
    """Combine two responses: one below a frequency, the other above.

    Within `CROSSOVER_OCTAVES` around the frequency the gains are ``cos(a) exp(-i a)`` and ``i sin(a) exp(-i a)``,
    where `a` goes from 0 to pi / 2. The gains add up to one, and so do their squares: the direct sound, which both
    responses share, stays as it is, and the energy has no notch where the responses are uncorrelated. Such steep
    filters ring ahead. Therefore nothing changes before the direct sound, and little within a quarter of a period
    after it.

    Parameters
    ----------
    low, high : ndarray, shape (n_low,), (n_high,)
    fs_hz, frequency_hz : float
    arrival_s : float
        Of the direct sound [s].

    Returns
    -------
    rir : ndarray, shape (n_high,)
    """
    n_samples, guard = len(high), int(_RINGING_S * fs_hz)
    n_fft = next_fast_len(n_samples + 2 * guard, real=True)
    at_hz = rfftfreq(n_fft, 1.0 / fs_hz)
    n_below = int(np.searchsorted(at_hz, frequency_hz * 2.0 ** (0.5 * CROSSOVER_OCTAVES)))  # the gain is 0 above
    octaves = np.log2(np.maximum(at_hz[:n_below], 1e-3) / frequency_hz) / CROSSOVER_OCTAVES
    angle = 0.5 * np.pi * np.sin(0.5 * np.pi * np.clip(octaves + 0.5, 0.0, 1.0)) ** 2
    difference = -high
    difference[:len(low)] += low[:n_samples]
    below = np.zeros(len(at_hz), np.complex64)  # whose rounding lies 140 dB below the difference
    below[:n_below] = np.cos(angle) * np.exp(-1j * angle) * rfft(difference.astype(np.float32), n_fft)[:n_below]
    change = irfft(below, n_fft)[:n_samples]
    n_rising = min(n_samples, int(np.ceil((arrival_s + 0.25 / frequency_hz) * fs_hz)))
    since = (np.arange(n_rising) / fs_hz - arrival_s) * 4.0 * frequency_hz
    change[:n_rising] *= np.sin(0.5 * np.pi * np.clip(since, 0.0, 1.0)) ** 2
    return high + change
