"""What the figures and tables of an RIR show: its parameters, band levels, decay curves and response, at any rate."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from roomeq.acoustics.decibels import FLOOR_POWER, power_db
from roomeq.acoustics.direct import DirectSound, find_direct
from roomeq.acoustics.excitation import excited_from_hz, excited_to_hz, limit_to_excitation
from roomeq.acoustics.fade import length_before_fade
from roomeq.acoustics.iso3382 import DECAYS_DB, Decay, energy_decay
from roomeq.acoustics.octaves import LEAD_S, octave_bands, octave_width_hz
from roomeq.acoustics.parameters import measure
from roomeq.acoustics.subband_eq import MIN_SNR_DB, energy_spectrum, eq_part, frame_length, response_and_noise
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, bands_hz, exact_bands_hz, require_fs


@dataclass(frozen=True)
class BandDecay:
    """The decay of one octave band, and the line that its decay time was read from.

    Attributes
    ----------
    band_hz : float
        Nominal mid-band frequency.
    time_s, level_db : ndarray, shape (n_frames,)
        Level of the band in frames of `FRAME_S` from the direct sound on.
    curve_s, curve_db : ndarray
        Decay curve (Schroeder integral without noise) up to the noise intersection, relative to its start.
    intersection_s : float
        Time at which the decay meets the noise, or the end of the response.
    has_noise : bool
        Whether the response reaches its noise floor.
    fit : tuple of (name, time_s, offset_db, valid), optional
        Decay time that a line was fitted to (T30, or T20 where the range is too small), its 60 dB time, the level of
        the line at the direct sound, and whether the value is valid. None without a line.
    """

    band_hz: float
    time_s: FloatArray
    level_db: FloatArray
    curve_s: FloatArray
    curve_db: FloatArray
    intersection_s: float
    has_noise: bool
    fit: tuple[str, float, float, bool] | None

    @property
    def visible_s(self) -> float:
        """Time at which the decay curve ends, or falls below `LOWEST_DB`."""
        below = np.flatnonzero(self.curve_db < LOWEST_DB)
        return float(self.curve_s[below[0]]) if len(below) else self.intersection_s


FRAME_S = 5e-3
"""Length of the frames of band levels [s]."""
LOWEST_DB = -70.0
"""Lower end of the figures of decays."""


@dataclass(frozen=True)
class AnalysedRir:
    """An RIR with its acoustic parameters.

    Attributes
    ----------
    name : str
        Label in figures and tables.
    samples : ndarray, shape (n_samples,)
    fs_hz : int
    direct : DirectSound
    parameters : dict
        As of `roomeq.acoustics.parameters.measure`, with one value for each of `bands_hz`.
    """

    name: str
    samples: FloatArray
    fs_hz: int
    direct: DirectSound
    parameters: dict[str, Any]

    @property
    def bands_hz(self) -> tuple[float, ...]:
        """Nominal mid-band frequencies of the octaves below half the sample rate."""
        return bands_hz(self.fs_hz)

    @property
    def direct_s(self) -> float:
        """Arrival of the direct sound after the start of the file."""
        return self.direct.sample / self.fs_hz

    @cached_property
    def decays(self) -> list[BandDecay]:
        """The decay of each octave band."""
        samples = self.samples[:length_before_fade(self.samples, self.fs_hz, self.direct.sample)]
        lead = round(LEAD_S * self.fs_hz)
        widths_hz = [octave_width_hz(band_hz, self.fs_hz) for band_hz in exact_bands_hz(self.fs_hz)]
        return [_band_decay(self, number, band[lead:], energy_decay(band, self.fs_hz, lead + self.direct.sample,
                                                                    bandwidth_hz=width_hz))
                for number, (band, width_hz)
                in enumerate(zip(octave_bands(samples, self.fs_hz, lead=lead), widths_hz, strict=True))]

    @cached_property
    def band_levels_db(self) -> FloatArray:
        """Level of each band relative to the loudest [dB], frames of `FRAME_S`, shape (n_bands, n_frames)."""
        levels_db = np.array([decay.level_db for decay in self.decays])
        return levels_db - levels_db.max()

    @cached_property
    def response(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies [Hz] and level relative to 1 kHz [dB] as the EQ analysis computes them; see `response_db`."""
        return response_db(self.samples, self.fs_hz, self.direct.sample)

    def shown_s(self) -> float:
        """Return the time after the direct sound to show: a margin beyond that at which the last band has decayed."""
        left_s = (len(self.samples) - self.direct.sample) / self.fs_hz
        return float(min(left_s, 1.15 * max(decay.visible_s for decay in self.decays)))


def analyse(samples: FloatArray, fs_hz: int, name: str = "RIR", direct: DirectSound | None = None) -> AnalysedRir:
    """Analyse an RIR.

    Parameters
    ----------
    samples : ndarray, shape (n_samples,)
    fs_hz : int
        Sample rate, 8 to 48 kHz.
    name : str
        Label in figures and tables; also begins the message of an error.
    direct : DirectSound, optional
        The direct sound if it is known; by default it is found.

    Raises
    ------
    ValueError
        The sample rate is out of range, or the response has no direct sound.
    """
    samples = np.asarray(samples, dtype=np.float64)
    try:
        fs_hz = require_fs(fs_hz)
        direct = find_direct(samples, fs_hz) if direct is None else direct
        parameters = measure_parameters(samples, fs_hz, direct)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return AnalysedRir(name, samples, fs_hz, direct, parameters)


def measure_parameters(samples: FloatArray, fs_hz: int, direct: DirectSound) -> dict[str, Any]:
    """Return the acoustic parameters of an RIR as `roomeq.acoustics.parameters.measure`, with the EQ at any rate.

    What lies outside the band of its own excitation is not valid (`roomeq.acoustics.excitation`).
    """
    parameters = measure(samples, fs_hz, direct=direct)
    if "eq_db" not in parameters:
        frequencies_hz, level_db = response_db(samples, fs_hz, direct.sample)
        eq_db = np.interp(bands_hz(fs_hz), frequencies_hz, level_db)
        parameters |= dict(eq_db=eq_db.tolist(), eq_valid=_eq_valid(samples, fs_hz, direct.sample))
    limit_to_excitation(parameters, excited_from_hz(samples, fs_hz), excited_to_hz(samples, fs_hz), fs_hz)
    return parameters


def _eq_valid(samples: FloatArray, fs_hz: int, direct_sample: float) -> list[bool]:
    """Tell which points of the EQ exceed the noise, as `roomeq.acoustics.subband_eq.analyse` does at 16 kHz.

    A point at half the sample rate, where the anti-alias filter ends, is not valid.
    """
    response, noise = response_and_noise(samples, direct_sample, fs_hz)
    points_hz = np.array(bands_hz(fs_hz))
    valid = points_hz < 0.5 * fs_hz
    if noise is not None:
        frequencies_hz = np.arange(len(noise)) * fs_hz / frame_length(fs_hz)
        at_points = [power_db(np.interp(points_hz, frequencies_hz, spectrum)) for spectrum in (response, noise)]
        above = at_points[0] - at_points[1] >= MIN_SNR_DB
        valid &= above & above[BAND_1KHZ]
    return [bool(point) for point in valid]


def response_db(samples: FloatArray, fs_hz: int, direct_sample: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies [Hz] and the energy spectrum of an RIR relative to 1 kHz [dB].

    The spectrum is that of the EQ analysis (`roomeq.acoustics.subband_eq`): from 16 ms before the direct sound to the
    noise, with a resolution of about 31 Hz.
    """
    start, stop = eq_part(samples, direct_sample, fs_hz)
    n_frame = frame_length(fs_hz)
    level_db = power_db(energy_spectrum(samples[start:stop], n_frame), FLOOR_POWER)
    frequencies_hz = np.arange(len(level_db)) * fs_hz / n_frame
    return frequencies_hz, level_db - np.interp(BANDS_HZ[BAND_1KHZ], frequencies_hz, level_db)


def _band_decay(rir: AnalysedRir, number: int, band: FloatArray, decay: Decay) -> BandDecay:
    frames = power_db(_frames(band, rir), FLOOR_POWER)
    step = max(1, round(1e-3 * rir.fs_hz))
    curve_db = decay.edc_db[::step]
    curve_s = np.arange(len(curve_db), dtype=np.float64) * step / rir.fs_hz
    return BandDecay(rir.bands_hz[number], FRAME_S * np.arange(0.5, len(frames)), frames, curve_s, curve_db,
                     decay.intersection.sample / rir.fs_hz, decay.noise_floor_db is not None,
                     _fitted_line(rir, number, decay))


def _frames(band: FloatArray, rir: AnalysedRir) -> FloatArray:
    """Return the mean power of each frame from the direct sound on."""
    n_frame = max(1, round(FRAME_S * rir.fs_hz))
    start = max(0, round(rir.direct.sample))
    power = np.square(band[start:])
    n_frames = max(1, len(power) // n_frame)
    return power[:n_frames * n_frame].reshape(n_frames, -1).mean(axis=1)


def _fitted_line(rir: AnalysedRir, number: int, decay: Decay) -> tuple[str, float, float, bool] | None:
    """Return the line of T30, or of T20 where T30 is invalid or absent; see `BandDecay.fit`."""
    names = [name for name in ("t30", "t20") if rir.parameters[f"{name}_s"][number] is not None]
    valid = [name for name in names if rir.parameters[f"{name}_valid"][number]]
    if not names:
        return None
    name = (valid or names[-1:])[0]
    time_s, level_db = rir.parameters[f"{name}_s"][number], decay.edc_db
    top_db, bottom_db = DECAYS_DB[name]
    part = np.flatnonzero((level_db <= top_db) & (level_db >= bottom_db))
    offset_db = float(np.mean(level_db[part] + 60.0 / time_s * part / rir.fs_hz))
    return name.upper(), time_s, offset_db, bool(valid)
