"""Physics of the synthetic RIR corpus: rigid-wall modes at low frequencies, image sources and a diffuse tail above.

All parts are spectra of `N_FFT` samples at 16 kHz. Time zero is the emission. The source makes p = 1/(4 pi r) at r
metres in the free field, so the parts have consistent levels without any adjustment.

References
----------
H. Kuttruff, Room Acoustics, 5th ed., 2009: (3.10) modal field, (4.6) image sources, (5.6) diffuse field.
ISO 9613-1:1993, table 1 (20 degrees C, 50 % relative humidity): attenuation by air.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]

FS_HZ = 16000
N_FFT = 32768
N_OUT = 16000  # samples of a written RIR, 1.0 s
FREQS_HZ = np.fft.rfftfreq(N_FFT, 1 / FS_HZ)
OCTAVES_HZ = 62.5 * 2.0 ** np.arange(8)
AIR_DB_PER_M = np.array([0.123, 0.445, 1.32, 2.73, 4.66, 9.86, 29.4, 104]) / 1000
OFF_AXIS_DB = np.array([0, 0, 0.5, 1, 2, 3.5, 5, 7])  # loss of the loudspeaker towards its back, per octave
MAX_ORDER = 3
LOUDSPEAKERS = ((80, ((170, 3.5, 1.6), (2700, 4, 2)), 9000),
                (115, ((360, -5, 1.2), (1400, 4, 1.8), (5200, 4, 2)), 6500))
"""The two loudspeakers: high-pass [Hz], resonances (centre [Hz], gain [dB], quality), low-pass [Hz]."""


@dataclass(frozen=True)
class Room:
    """A shoebox.

    Attributes
    ----------
    dims_m
        Length, width and height [m], shape (3,).
    t60_s
        Decay time per octave without air absorption [s], shape (8,).
    wall_share
        Absorption of x=0, x=L, y=0, y=L, z=0, z=L relative to the mean, shape (6,). The area-weighted mean is 1.
    scattering
        Share of the reflected energy that leaves the specular path, in [0, 1].
    temperature_c
        Air temperature [degrees C].
    mode_jitter
        Seed of the spread of the modes' decay.
    """

    dims_m: FloatArray
    t60_s: FloatArray
    wall_share: FloatArray
    scattering: float
    temperature_c: float
    mode_jitter: int

    @property
    def c_m_s(self) -> float:
        """Speed of sound [m/s]."""
        return 331.3 * np.sqrt(1 + self.temperature_c / 273.15)

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return float(np.prod(self.dims_m))

    @property
    def wall_areas_m2(self) -> FloatArray:
        """Wall areas in the order of `wall_share` [m^2], shape (6,)."""
        x, y, z = self.dims_m
        return np.repeat([y * z, x * z, x * y], 2)

    @property
    def total_t60_s(self) -> FloatArray:
        """Decay time per octave with walls and air [s], shape (8,)."""
        return 1 / (1 / self.t60_s + AIR_DB_PER_M * self.c_m_s / 60)

    @property
    def wall_absorption(self) -> FloatArray:
        """Absorption per wall and octave by Eyring's formula, shape (6, 8), in [0, 0.95]."""
        area = self.wall_areas_m2.sum()
        mean = 1 - np.exp(-55.26 * self.volume_m3 / (self.c_m_s * area * self.t60_s))
        return np.minimum(mean * self.wall_share[:, None], 0.95)

    @property
    def crossover_hz(self) -> float:
        """Crossover from the modal part to the rest: twice Schroeder's frequency, limited to 250-350 Hz."""
        return float(np.clip(4000 * np.sqrt(self.total_t60_s[4] / self.volume_m3), 250, 350))


def octave_weights() -> FloatArray:
    """Return raised-cosine windows over log frequency that add up to one, shape (8, N_FFT / 2 + 1)."""
    octave = np.log2(np.maximum(FREQS_HZ, 1) / OCTAVES_HZ[0]).clip(0, 7)
    distance = np.abs(octave - np.arange(8)[:, None])
    return np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * distance), 0)


OCTAVE_WEIGHTS = octave_weights()


def low_weight(crossover_hz: float) -> FloatArray:
    """Return the amplitude weight of the modal part: a raised cosine, one octave wide, around `crossover_hz`."""
    octave = np.log2(np.maximum(FREQS_HZ, 1) / crossover_hz).clip(-0.5, 0.5)
    return 0.5 - 0.5 * np.sin(np.pi * octave)


def modal_spectra(room: Room, source_m: FloatArray, mics_m: FloatArray, f_max_hz: float) -> ComplexArray:
    """Return the sound field of the damped modes of a rigid shoebox.

    Green's function of the wave equation: c^2/V sum_n psi_n(s) psi_n(m) / (w_n^2 + d_n^2 - w^2 + 2j d_n w), with
    d_n = 6.91/T60(f_n) and psi_n a product of cosines times sqrt(2) per index that isn't zero (Kuttruff, 3.10).

    Parameters
    ----------
    room
    source_m
        Shape (3,).
    mics_m
        Shape (n_mics, 3).
    f_max_hz
        Highest frequency of the result; modes up to 1.3 times this frequency are summed.

    Returns
    -------
    ndarray of complex, shape (n_mics, N_FFT / 2 + 1)
        Pressure spectra; zero above `f_max_hz`.
    """
    c = room.c_m_s
    counts = np.floor(2 * 1.3 * f_max_hz / c * room.dims_m).astype(int) + 1
    index = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1).reshape(-1, 3)[1:]
    mode_hz = c / 2 * np.linalg.norm(index / room.dims_m, axis=1)
    keep = mode_hz < 1.3 * f_max_hz
    index, mode_hz = index[keep], mode_hz[keep]
    t60_s = np.interp(np.log(mode_hz), np.log(OCTAVES_HZ), room.total_t60_s)
    damping = 6.91 / t60_s * np.random.default_rng(room.mode_jitter).uniform(0.85, 1.15, len(mode_hz))

    def shapes(position_m: FloatArray) -> FloatArray:
        cosines = np.cos(np.pi * index * (position_m / room.dims_m))
        return np.prod(np.where(index > 0, np.sqrt(2), 1) * cosines, axis=1)

    pairs = np.stack([shapes(m) for m in mics_m], 1) * shapes(source_m)[:, None] * c**2 / room.volume_m3
    omega = 2 * np.pi * FREQS_HZ[1:][FREQS_HZ[1:] <= f_max_hz]
    field = np.zeros((len(FREQS_HZ), len(mics_m)), complex)
    for start in range(0, len(omega), 128):  # in blocks: the matrix of all frequencies and modes would take 150 MB
        w = omega[start:start + 128, None]
        resonances = 1 / ((2 * np.pi * mode_hz) ** 2 + damping**2 - w**2 + 2j * damping * w)
        field[1 + start:1 + start + len(w)] = resonances.real @ pairs + 1j * (resonances.imag @ pairs)
    return field.T


def image_sources(room: Room, source_m: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the image sources up to `MAX_ORDER`.

    Returns
    -------
    positions_m : ndarray, shape (n, 3)
    mirrored : ndarray, shape (n, 3)
        -1 along the axes in which the image is mirrored, else 1.
    hits : ndarray of int, shape (n, 6)
        Reflections per wall, in the order of `Room.wall_share`.
    """
    span = np.arange(-MAX_ORDER, MAX_ORDER + 1)
    n = np.stack(np.meshgrid(span, span, span, indexing="ij"), -1).reshape(-1, 3)
    n = n[np.abs(n).sum(1) <= MAX_ORDER]
    n = n[np.lexsort((*n.T, np.abs(n).sum(1)))]
    odd = n % 2 == 1
    positions_m = n * room.dims_m + np.where(odd, room.dims_m - source_m, source_m)
    # |n| reflections alternate between two opposite walls; the sign of n says which wall is first.
    far, near = np.where(n > 0, (n + 1) // 2, -n // 2), np.where(n > 0, n // 2, (1 - n) // 2)
    hits = np.stack([near, far], -1).reshape(-1, 6)
    return positions_m, np.where(odd, -1, 1), hits


def facing_loss_db(cosine: FloatArray) -> FloatArray:
    """Return the loudspeaker's loss per octave for cosines of the angle from its axis [dB], shape (..., 8)."""
    return OFF_AXIS_DB * (1 - np.asarray(cosine)[..., None]) / 2


def diffuse_loss_db() -> FloatArray:
    """Return the loudspeaker's radiated power relative to its axis per octave [dB, negative], shape (8,)."""
    gains = 10 ** (-facing_loss_db(np.linspace(-1, 1, 201)) / 10)
    return 10 * np.log10(gains.mean(0))


def add_pulses(length: int, delays: FloatArray, amplitudes: FloatArray) -> FloatArray:
    """Return band-limited pulses at fractional delays.

    Parameters
    ----------
    length
        Length of the result [samples].
    delays
        Delay of each pulse [samples], shape (n,).
    amplitudes
        Amplitudes per band, shape (n, n_bands).

    Returns
    -------
    ndarray, shape (n_bands, length)
    """
    offsets = np.arange(-31, 33)
    first = np.floor(delays).astype(int)
    shift = offsets - (delays - first)[:, None]
    kernel = np.sinc(shift) * np.cos(np.pi * shift / 66) ** 2
    at = first[:, None] + offsets
    inside = (at >= 0) & (at < length)
    out = np.zeros((amplitudes.shape[1], length))
    for band, gains in zip(out, amplitudes.T, strict=True):
        np.add.at(band, at[inside], (kernel * gains[:, None])[inside])
    return out


def early_and_tail(room: Room, source_m: FloatArray, mic_m: FloatArray, facing: FloatArray,
                   rng: np.random.Generator) -> tuple[ComplexArray, ComplexArray]:
    """Return the sound at a microphone above the modal range.

    Parameters
    ----------
    room
    source_m, mic_m, facing
        Positions, and the unit vector of the loudspeaker's axis, each of shape (3,).
    rng
        Draws the tail.

    Returns
    -------
    early, tail : ndarray of complex, shape (N_FFT / 2 + 1,)
        Direct sound with image sources, and the diffuse rest. Time zero is the emission.
    """
    c = room.c_m_s
    positions_m, mirrored, hits = image_sources(room, source_m)
    paths = mic_m - positions_m
    distance_m = np.linalg.norm(paths, axis=1)
    cosine = (paths * mirrored / distance_m[:, None]) @ facing
    kept = np.log(1 - room.wall_absorption)
    order = hits.sum(1)
    specular = (1 - room.scattering) ** order
    energy = specular[:, None] * np.exp(hits @ kept)
    loss_db = facing_loss_db(cosine) + AIR_DB_PER_M * distance_m[:, None]
    amplitudes = np.sqrt(energy) * 10 ** (-loss_db / 20) / (4 * np.pi * distance_m[:, None])
    early = add_pulses(N_FFT, distance_m / c * FS_HZ, amplitudes)

    # Images of all orders arrive with density 4 pi c^3 t^2 / V; the tail replaces those beyond MAX_ORDER.
    time_s = np.arange(N_FFT) / FS_HZ
    edges = np.arange(0, N_FFT + 1, 160)
    arrived, _ = np.histogram(distance_m / c * FS_HZ, edges, weights=specular)
    expected = 4 * np.pi * c**3 / (3 * room.volume_m3) * np.diff((edges / FS_HZ) ** 3)
    share = np.convolve(arrived, np.ones(3), "same") / np.convolve(expected, np.ones(3), "same")
    missing = np.interp(time_s, edges[:-1] / FS_HZ + 0.005, 1 - np.minimum(share, 1))
    missing[time_s <= distance_m[0] / c] = 0
    # Diffuse field: energy c/(4 pi V) exp(-13.8 t/T) per second; its integral is 4/A of the source's power.
    decay = np.exp(-6.91 * time_s / room.total_t60_s[:, None]) * 10 ** (diffuse_loss_db()[:, None] / 20)
    level = np.sqrt(c / (4 * np.pi * room.volume_m3) / FS_HZ)
    tail = rng.standard_normal((8, N_FFT)) * decay * np.sqrt(missing) * level
    # Eight independent noises add in power, so their windows are square roots of windows that add up to one.
    spectrum = np.sum(np.fft.rfft(tail) * np.sqrt(OCTAVE_WEIGHTS), 0)
    return np.sum(np.fft.rfft(early) * OCTAVE_WEIGHTS, 0), spectrum


def loudspeaker(freqs_hz: npt.NDArray[np.floating], model: int) -> ComplexArray:
    """Return the on-axis frequency response of one of the `LOUDSPEAKERS`.

    A second-order high-pass, resonances and a first-order low-pass, all as analogue filters.

    Parameters
    ----------
    freqs_hz
    model
        Index into `LOUDSPEAKERS`.

    Returns
    -------
    ndarray of complex
        About 1 in mid frequencies.
    """
    s = 1j * np.asarray(freqs_hz, float)
    high_pass_hz, resonances, low_pass_hz = LOUDSPEAKERS[model]
    response = s**2 / (s**2 + s * high_pass_hz / 0.75 + high_pass_hz**2) / (1 + s / low_pass_hz)
    for centre_hz, gain_db, q in resonances:
        width = s * centre_hz / q
        response = response * (s**2 + 10 ** (gain_db / 20) * width + centre_hz**2) / (s**2 + width + centre_hz**2)
    return response


def causal_window(arrival_s: float) -> FloatArray:
    """Return the time window that removes all sound before the direct sound, shape (N_FFT,).

    The windows over frequency have zero phase, so they ring before the arrival as well as after it.
    """
    ahead_ms = 1000 * (arrival_s - np.arange(N_FFT) / FS_HZ)
    return np.where(np.arange(N_FFT) > N_FFT // 2, 0, 0.5 + 0.5 * np.cos(np.pi * (ahead_ms - 1).clip(0, 1)))


def impulse_responses(room: Room, source_m: FloatArray, mics_m: FloatArray, facing: FloatArray,
                      direct_samples: FloatArray, rngs: list[np.random.Generator], model: int = 0) -> FloatArray:
    """Return the noiseless responses from one loudspeaker position to all microphones.

    Parameters
    ----------
    room
    source_m, facing
        Position and unit vector of the axis, each of shape (3,).
    mics_m
        Shape (n_mics, 3).
    direct_samples
        Position of the direct sound in each response [samples], shape (n_mics,).
    rngs
        One generator per microphone.
    model
        Index into `LOUDSPEAKERS`.

    Returns
    -------
    ndarray, shape (n_mics, N_OUT)
    """
    low = low_weight(room.crossover_hz)
    # Direct sound and images are in phase with the modal field, so their weights add up to one; the tail is not.
    modal = modal_spectra(room, source_m, mics_m, room.crossover_hz * np.sqrt(2))
    out = np.empty((len(mics_m), N_OUT))
    for k, (mic_m, rng) in enumerate(zip(mics_m, rngs, strict=True)):
        early, tail = early_and_tail(room, source_m, mic_m, facing, rng)
        spectrum = low * modal[k] + (1 - low) * early + np.sqrt(1 - low**2) * tail
        arrival_s = float(np.linalg.norm(mic_m - source_m)) / room.c_m_s
        spectrum = np.fft.rfft(np.fft.irfft(spectrum) * causal_window(arrival_s))
        shift_s = direct_samples[k] / FS_HZ - arrival_s
        spectrum = spectrum * loudspeaker(FREQS_HZ, model) * np.exp(-2j * np.pi * FREQS_HZ * shift_s)
        out[k] = np.fft.irfft(spectrum)[:N_OUT]
    return out
