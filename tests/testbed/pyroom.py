"""Another base: the hybrid simulator of pyroomacoustics 0.10, of image sources and rays.

Octaves from 62.5 Hz as everywhere here, walls as filters of minimum phase, the high-pass filter off. Levels are ours
(its direct sound is 1/r, ours 1/(4 pi r)), and so is sample 0 (it delays all by half the length of a fractional delay).
Its random numbers are global: they are seeded before each use.
"""

from functools import cache, lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyroomacoustics as pra
from pyroomacoustics.simulation.ism import compute_ism_rir
from pyroomacoustics.simulation.rt import directional_sequence, interp_hist, poisson_sequence

from testbed.air import absorption_db_per_m
from testbed.draws import C0, FS_HZ, LENGTH_S, N_BANDS, N_FFT, N_SAMPLES, OCTAVES_HZ, generator
from testbed.own import add_pulses
from testbed.paths import COARSE, Field, Images, kept, version
from testbed.trace import BIN_M, N_ANGLES, N_BINS

MAX_ORDER = 9  # of its image sources
N_RAYS = 10000
BINS = 4  # of ours in one of its histogram
BIN_S = BINS * BIN_M / C0
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
MIDDLES_HZ = np.sqrt(OCTAVES_HZ / np.sqrt(2.0) * np.minimum(OCTAVES_HZ * np.sqrt(2.0), FS_HZ / 2.0))
"""Middle of what each octave has below half the sample rate: the highest ends there."""


class Octaves:
    """Its octave filters, with what does not change from path to path computed once."""

    def __init__(self, bank):
        self.bank = bank
        self.each = bank.synthesis(np.eye(N_BANDS))

    def synthesis(self, coefficients, min_phase):
        """Return filters of minimum phase for coefficients of shape (n, 8): its own ones, which are linear."""
        assert min_phase
        magnitude = np.abs(np.fft.rfft(coefficients @ self.each, axis=-1))
        return pra.acoustics.magnitude_response_to_minimum_phase(magnitude, self.each.shape[1], eps=1e-7)


@cache
def set_up():
    """Set its constants; return its octave filters and the length of its fractional delays."""
    for name, value in dict(octave_bands_base_freq=OCTAVES_HZ[0], rir_hpf_enable=False, num_threads=1).items():
        pra.constants.set(name, value)
    box = _shoebox(np.ones(3), np.ones((6, N_BANDS)), np.zeros(6))
    return Octaves(box.octave_bands), pra.constants.get("frac_delay_length")


def _shoebox(dims_m, absorption, scattering):
    def per_octave(values):
        return dict(coeffs=[float(value) for value in values], center_freqs=OCTAVES_HZ.tolist())

    walls = {wall: pra.Material(per_octave(absorption[k]), per_octave(np.full(N_BANDS, scattering[k])))
             for k, wall in enumerate(WALLS)}
    box = pra.ShoeBox(dims_m, fs=FS_HZ, materials=walls, max_order=MAX_ORDER, ray_tracing=True, min_phase=True)
    box.set_sound_speed(C0)
    box.set_ray_tracing(n_rays=N_RAYS, time_thres=LENGTH_S, hist_bin_size=BIN_S)
    return box


def fields_of(room, cache=None):
    """Return the fields of a room's eight pairs, with rays from a cache folder where they lie in it."""
    set_up()
    path = cache and Path(cache) / f"{room.room_id}-{version('pyroom.py')}-{pra.__version__}.npz"
    energy, share = kept(path, lambda: _rays(room))
    return [Field(room, rir, _image_sources(room, rir), energy[k], share[k], cache, pra.__name__)
            for k, rir in enumerate(room.rirs)]


def pair(room, rir):
    """Return the simulated room with one source and one microphone."""
    box = _shoebox(room.dims_m, room.absorption, room.scattering)
    box.add_source(room.sources_m[rir.source])
    box.add_microphone(room.mics_m[rir.mic])
    return box


def _image_sources(room, rir):
    box = pair(room, rir)
    box.image_source_model()
    source, seen = box.sources[0], box.visibility[0][0] > 0
    length = np.linalg.norm(source.images[:, seen] - room.mics_m[rir.mic][:, None], axis=0).astype(float)
    nearest = np.argsort(length, kind="stable")
    return Images(length[nearest], source.directions[0][:, seen].T[nearest].astype(float),
                  source.damping[:, seen][:, nearest].astype(float), source.orders[seen][nearest])


def _rays(room):
    """Energy of each pair, shape (8, 8, N_BINS), and shares of the angles, shape (8, N_ANGLES, 8, N_BINS // COARSE).

    The rays of each class of angles to where the source faces are traced by themselves.
    """
    ways = pra.doa.fibonacci_spherical_sampling(N_RAYS).T
    traced = np.zeros((len(room.rirs), N_ANGLES, N_BANDS, N_BINS // BINS))
    for k, rir in enumerate(room.rirs):
        engine = pair(room, rir).room_engine
        seed_by("pyroomacoustics rays", room.seed, rir.rir_id)
        classes = np.clip((ways @ rir.facing + 1.0) / 2.0 * N_ANGLES, 0, N_ANGLES - 1).astype(int)
        for angle in range(N_ANGLES):
            some = ways[classes == angle]
            engine.ray_tracing(some, np.ones((len(some), N_BANDS)), room.sources_m[rir.source])
            found = engine.microphones[0].histograms[0].get_hist()[:, :N_BINS // BINS]
            traced[k, angle, :, :found.shape[1]] = found * len(some) / N_RAYS
            engine.reset_mics()
    energy = traced.sum(axis=1) / (4.0 * np.pi) ** 2
    coarse = traced.reshape(*traced.shape[:-1], -1, COARSE // BINS).sum(axis=-1)
    total = coarse.sum(axis=1, keepdims=True)
    share = np.divide(coarse, total, out=np.full_like(coarse, 1.0 / N_ANGLES), where=total > 0.0)
    return np.repeat(energy / BINS, BINS, axis=-1), share


def seed_by(purpose, seed, what):
    """Seed its random numbers, and those of its rays."""
    pra.random.seed(int(generator(seed, purpose, what).integers(2 ** 62)))


def air_coefficients(air):
    """Energy that air takes per octave [1/m]."""
    return absorption_db_per_m(MIDDLES_HZ, *air) * np.log(10.0) / 10.0


class AllAround:
    """A source that radiates an impulse everywhere: with it walls are rendered by filters of minimum phase."""

    is_impulse_response = True

    def get_response(self, azimuth, **angles):
        return np.ones((len(azimuth), 1))


def pulses(length_m, pressure, speed, air):
    """Spectrum of paths that each have a pressure per octave, shape (8, n)."""
    return _pulses(length_m.tobytes(), pressure.tobytes(), speed, air)


@lru_cache(maxsize=128)
def _pulses(length_m, pressure, speed, air):
    length_m = np.frombuffer(length_m)
    octaves, taps = set_up()
    n = len(length_m)
    images, nowhere = np.zeros((3, n)), np.zeros(3)
    images[0] = length_m
    source = SimpleNamespace(images=images, damping=np.frombuffer(pressure).reshape(N_BANDS, n) * length_m,
                             directivity=AllAround())
    rir = compute_ism_rir(source, nowhere, None, np.ones((3, n)), np.ones(n, dtype=bool), taps, speed, FS_HZ, octaves,
                          min_phase=True, air_abs_coeffs=air_coefficients(air))
    return np.fft.rfft(rir[taps // 2:][:N_SAMPLES], N_FFT)


def spread(energy):
    """It draws lines between its bins as it renders."""
    return energy


def late(field, energy, speed, air):
    """Spectrum of noise with the energy of its rays, in time as far as the speed of sound says."""
    way_m = np.arange(N_SAMPLES) / FS_HZ * C0
    histogram = interp_hist(energy.reshape(N_BANDS, -1, BINS).sum(axis=-1), N_SAMPLES)
    wear = np.exp(-0.5 * air_coefficients(air)[:, None] * way_m)
    rir = np.sum(_carrier(field.room, field.rir.rir_id, field.images.length_m[0]) * np.sqrt(histogram) * wear, axis=0)
    if speed != C0:
        slow, rir = rir, np.zeros((1, N_SAMPLES))
        add_pulses(rir, np.arange(N_SAMPLES) * (C0 / speed), slow[None])
        rir = rir[0]
    return np.fft.rfft(rir, N_FFT)


@lru_cache(maxsize=80)
def _carrier(room, rir_id, direct_m):
    """Noise of a pair per octave, shape (8, N_SAMPLES), with energy 1 in each bin of its histogram over all octaves."""
    octaves, _ = set_up()
    seed_by("pyroomacoustics late", room.seed, rir_id)
    start_s, times_s = poisson_sequence(room.volume_m3, N_SAMPLES / FS_HZ, C0, t0=direct_m / C0)
    noise = directional_sequence(start_s, times_s, np.ones((1, 1)), np.ones((1, N_BINS // BINS)), BIN_S, FS_HZ)
    return octaves.bank.analysis(noise[:N_SAMPLES]).T.astype(np.float32)


def finished(rir, speed, air):
    """Air has taken its part already."""
    return rir
