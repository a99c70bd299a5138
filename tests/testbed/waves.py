"""The low-frequency field of a shoebox by finite differences, with lossy walls."""

import os
from functools import lru_cache
from pathlib import Path

import numba
import numpy as np
from scipy.optimize import brentq

from testbed.draws import C0, FREQUENCY_HZ, FS_HZ, LENGTH_S, N_FFT
from testbed.paths import version
from testbed.render import Extra
from testbed.rooms import N_SOURCES

HIGHEST_HZ = 300.0
POINTS = 8.0  # per wavelength there
LOWEST_HZ = 22.0  # below it no loudspeaker has anything to say
WIDTH_OCTAVES = 0.5  # of the crossover to the rays
N_LOW_BANDS = 3  # octaves whose walls count here: 62.5, 125, 250 Hz
PERIOD_S = N_FFT / FS_HZ
FADE_S = 0.25
N_LOW = int(np.searchsorted(FREQUENCY_HZ, HIGHEST_HZ * 1.2))


def random_incidence(impedance):
    """Random-incidence absorption of a real specific impedance (Kuttruff, Room Acoustics, eq. 2.53)."""
    z = impedance
    return 8.0 / z * (1.0 + 1.0 / (1.0 + z) - 2.0 / z * np.log1p(z))


def impedance_of(absorption):
    """Real specific impedance above 1.567 (where absorption is largest, 0.951) with a random-incidence absorption."""
    return brentq(lambda z: random_incidence(z) - min(absorption, 0.95), 1.567, 1e5)


@numba.njit(cache=True, fastmath=True)
def _march(now, before, ratio, loss, out_cells, out_weights, out):
    """March pressures in place, walls half a cell beyond the outermost cells; `loss` has axes (3, 2)."""
    nx, ny, nz = now.shape
    rx, ry, rz = ratio
    for step in range(out.shape[1]):
        for m in range(len(out_cells)):
            total = 0.0
            for k in range(8):
                total += out_weights[m, k] * now[out_cells[m, k, 0], out_cells[m, k, 1], out_cells[m, k, 2]]
            out[m, step] = total
        for i in range(nx):
            lossx = loss[0, 0] if i == 0 else loss[0, 1] if i == nx - 1 else np.float32(0.0)
            for j in range(ny):
                lossy = lossx + (loss[1, 0] if j == 0 else loss[1, 1] if j == ny - 1 else np.float32(0.0))
                edge = i == 0 or i == nx - 1 or j == 0 or j == ny - 1
                west = now[max(i - 1, 0), j]
                east = now[min(i + 1, nx - 1), j]
                south = now[i, max(j - 1, 0)]
                north = now[i, min(j + 1, ny - 1)]
                row, old = now[i, j], before[i, j]
                for k in (0, nz - 1):
                    below, above = row[max(k - 1, 0)], row[min(k + 1, nz - 1)]
                    lost = lossy + (loss[2, 0] if k == 0 else loss[2, 1])
                    p = row[k]
                    change = (rx * (west[k] + east[k] - p - p) + ry * (south[k] + north[k] - p - p)
                              + rz * (below + above - p - p))
                    old[k] = (p + p + change - (np.float32(1.0) - lost) * old[k]) / (np.float32(1.0) + lost)
                if edge:
                    gain = np.float32(1.0) / (np.float32(1.0) + lossy)
                    keep = np.float32(1.0) - lossy
                    for k in range(1, nz - 1):
                        p = row[k]
                        change = (rx * (west[k] + east[k] - p - p) + ry * (south[k] + north[k] - p - p)
                                  + rz * (row[k - 1] + row[k + 1] - p - p))
                        old[k] = (p + p + change - keep * old[k]) * gain
                else:
                    for k in range(1, nz - 1):
                        p = row[k]
                        change = (rx * (west[k] + east[k] - p - p) + ry * (south[k] + north[k] - p - p)
                                  + rz * (row[k - 1] + row[k + 1] - p - p))
                        old[k] = p + p + change - old[k]
        now, before = before, now


def _trilinear(point, spacing, shape):
    """Cells around a point and their weights, shape (8, 3) and (8,); pressures stand in the middle of cells."""
    place = np.clip(point / spacing - 0.5, 0.0, np.array(shape) - 1.000001)
    first = np.floor(place).astype(int)
    part = place - first
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    return first + corners, np.prod(np.where(corners == 1, part, 1.0 - part), axis=1)


def responses(dims, source, mics, impedances, length_s=LENGTH_S):
    """Pressure at microphones after a unit impulse of the source, which makes 1/(4 pi r) in free space.

    Parameters
    ----------
    dims, source : ndarray, shape (3,)
    mics : ndarray, shape (n_mics, 3)
    impedances : sequence of float
        Of the six walls (x=0, x=L, ...), relative to that of air.
    length_s : float

    Returns
    -------
    pressure : ndarray, shape (n_mics, n_steps)
        Integral over a step [1/m].
    step_s : float
    """
    shape = np.maximum(np.ceil(dims * POINTS * HIGHEST_HZ / C0).astype(int), 4)
    spacing = dims / shape
    longest_s = 0.999 / (C0 * np.sqrt(np.sum(spacing ** -2)))
    step_s = PERIOD_S / np.ceil(PERIOD_S / longest_s)  # so that a transform has the frequencies of the rendering
    courant = C0 * step_s / spacing
    loss = 0.5 * courant[:, None] / np.reshape(impedances, (3, 2))
    now, before = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    cells, weights = _trilinear(source, spacing, shape)
    for cell, weight in zip(cells, weights, strict=True):
        now[tuple(cell)] += weight * C0 ** 2 * step_s ** 2 / np.prod(spacing)
    around = [_trilinear(mic, spacing, shape) for mic in mics]
    out = np.zeros((len(mics), round(length_s / step_s)))
    _march(now, before, np.array(courant ** 2, dtype=np.float32), loss.astype(np.float32),
           np.array([cell for cell, _ in around]), np.array([weight for _, weight in around]), out)
    return out, step_s


@lru_cache(maxsize=64)
def _transfers(room_id, room, cache):
    """Low-frequency transfer functions of a room's pairs, shape (2, 4, N_LOW)."""
    path = cache and Path(cache) / f"{room_id}-waves-{version('waves.py')}.npy"
    if path and path.is_file():
        return np.load(path)
    # one run with the least absorption of each wall, then every octave damped by what it lacks
    walls = room.absorption[:, :N_LOW_BANDS]
    least = walls.min(axis=1)
    impedances = [impedance_of(a) for a in least]
    nepers = -np.log1p(-np.array([room.areas_m2 @ a for a in (*walls.T, least)]) / room.areas_m2.sum())
    rates = C0 * room.areas_m2.sum() * (nepers[:-1] - nepers[-1]) / (8.0 * room.volume_m3)
    octave = np.log2(np.maximum(FREQUENCY_HZ[:N_LOW], 1.0) / 62.5)
    hats = np.array([np.interp(octave, np.arange(N_LOW_BANDS), np.eye(N_LOW_BANDS)[b]) for b in range(N_LOW_BANDS)])
    result = []
    for s in range(N_SOURCES):
        # faded out behind the end of the recordings: a fade of the static pressure within them adds low frequencies
        pressure, step_s = responses(room.dims_m, room.sources_m[s], room.mics_m, impedances, LENGTH_S + FADE_S)
        time_s = np.arange(pressure.shape[1]) * step_s
        fade = np.sin(0.5 * np.pi * np.clip((time_s[-1] - time_s) / FADE_S, 0.0, 1.0)) ** 2
        n = round(PERIOD_S / step_s)
        result.append(sum(hat * np.fft.rfft(pressure * fade * np.exp(-rate * time_s), n)[:, :N_LOW]
                          for hat, rate in zip(hats, rates, strict=True)))
    result = np.array(result)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.npy")
        np.save(partial, result)
        partial.replace(path)
    return result


def causal(magnitude):
    """Minimum-phase transfer function of a magnitude (Oppenheim & Schafer, by the cepstrum): no sound comes early."""
    cepstrum = np.fft.irfft(np.log(np.maximum(magnitude, 1e-3)))
    cepstrum[1:len(cepstrum) // 2] *= 2.0
    cepstrum[len(cepstrum) // 2 + 1:] = 0.0
    return np.exp(np.fft.rfft(cepstrum))


def draw_modes(seed, rooms):
    """Nothing is left to draw: the field follows from the room."""
    return {}


def share_of_waves(hz):
    """Share of the pressure that the wave field has below a crossover frequency, of zero phase; 0 below `LOWEST_HZ`."""
    octave = np.log2(np.maximum(FREQUENCY_HZ, 1.0))
    up, down = (np.clip((octave - np.log2(edge)) / WIDTH_OCTAVES + 0.5, 0.0, 1.0) for edge in (LOWEST_HZ, hz))
    return np.sin(0.5 * np.pi * up) ** 2 * np.cos(0.5 * np.pi * down) ** 2


def modes(parameters, scale):
    """The wave field below a crossover of `scale` Hz, rays above."""
    share = share_of_waves(scale)
    late = causal(np.sqrt(1.0 - share ** 2))

    def wave(field):
        transfer = np.zeros(N_FFT // 2 + 1, dtype=complex)
        transfer[:N_LOW] = _transfers(field.room.room_id, field.room, field.cache)[field.rir.source, field.rir.mic]
        return transfer, share, late
    return Extra(wave=wave)
