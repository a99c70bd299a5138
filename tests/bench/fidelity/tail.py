"""Statistics of the late tail: Gaussian, dense in time as a room is, never repeating, flat over frequency."""

import numpy as np

from bench import ours
from bench.kit import Check, Section

ROOM_M, ABSORPTION, SCATTERING = (12.0, 8.0, 4.0), 0.15, 0.5
WINDOW = 320  # samples of 20 ms: the window of the echo density
LATE_S = 0.15
SOURCE = (2.1, 3.3, 1.5)
GAUSSIAN_SHARE = 0.31731  # of samples beyond one standard deviation


def run(quick):
    """Kurtosis, echo density, autocorrelation, spectrum."""
    n_mics = 6 if quick else 30
    rng = np.random.default_rng(4)
    mics = rng.uniform(1.0, np.asarray(ROOM_M) - 1.0, (n_mics, 3))
    scene = ours.box_scene(ROOM_M, ABSORPTION, SCATTERING)
    responses = ours.simulate(scene, SOURCE, mics)
    tails = [_whitened(one) for one in responses]
    kurtosis = float(np.mean([np.mean(tail ** 4) / np.mean(tail ** 2) ** 2 for tail in tails]))
    time_s, density, expected = _densities(responses)
    reached = [float(time_s[np.argmax(curve >= 0.9)]) for curve in (density, expected)]
    own = max(_largest_correlation(tail, tail) for tail in tails)
    between = max(_largest_correlation(one, other) for one, other in zip(tails[1:], tails[:-1], strict=True))
    frequency, level_db = _spectrum(responses)
    edges = np.max(np.abs(level_db[(frequency > 240.0) & (frequency < 7500.0)]))
    ripple_db = ours.filterbank_ripple_db()
    checks = [Check("sum of the octave filters, ripple", ripple_db, high=0.1, unit="dB"),
              Check("kurtosis of the tail (Gaussian: 3)", kurtosis, low=2.8, high=3.2),
              Check("largest autocorrelation, in units of what chance gives", own, high=1.5),
              Check("largest correlation between microphones, likewise", between, high=1.5),
              Check("spectrum of the tails in third octaves, largest deviation", float(edges), high=1.0, unit="dB"),
              Check("largest echo density (1: Gaussian; more: pulses of one size)", float(np.max(density)), high=1.15),
              Check("echo density reaches 0.9 after", 1e3 * reached[0], unit="ms"),
              Check("that of Poisson arrivals after", 1e3 * reached[1], unit="ms")]
    rows = [[1e3 * t, d, e] for t, d, e in zip(time_s[::4], density[::4], expected[::4], strict=True)][:12]
    return Section("tail", "Statistics of the tail, 12x8x4 m, alpha 0.15, scattering 0.5",
                   ["time, ms", "echo density", "of Poisson arrivals"], rows, checks,
                   ["echo density: share of samples beyond one standard deviation over the Gaussian's (Abel and Huang "
                    "2006), 20 ms windows; Poisson arrivals: pulses at the rate 4 pi c^3 t^2 / V, as of mirror walls"],
                   {"frequency": list(frequency), "level_db": list(level_db), "time_s": list(time_s),
                    "density": list(density), "expected": list(expected)})


def _whitened(one):
    """Tail from `LATE_S` to -40 dB, divided by its own envelope."""
    power = one.rir ** 2
    left = np.cumsum(power[::-1])[::-1]
    last = int(np.argmax(left < 1e-4 * left[0])) or len(power)
    tail = one.rir[int(LATE_S * one.fs_hz):last]
    time = np.arange(len(tail))
    slope = np.polyfit(time, np.log(np.convolve(tail ** 2, np.ones(801) / 801, "same") + 1e-30), 2)
    tail = tail * np.exp(-0.5 * np.polyval(slope, time))
    return tail / np.std(tail)


def _largest_correlation(one, other):
    """Largest correlation at any lag from 2 ms on, over the largest that chance gives, sqrt(2 ln n / n)."""
    n = min(len(one), len(other))
    spectrum = np.fft.rfft(one[:n], 2 * n) * np.conj(np.fft.rfft(other[:n], 2 * n))
    lags = np.fft.irfft(spectrum)[32:3 * n // 4]
    overlap = n - np.arange(32, 3 * n // 4)
    return float(np.max(np.abs(lags) / np.sqrt(overlap)) / np.sqrt(2.0 * np.log(n)))


def _densities(responses):
    """Echo density from the direct sound on, mean over the responses, and that of Poisson arrivals."""
    curves, expected = [], []
    rng = np.random.default_rng(11)
    for one in responses:
        first = int(one.direct_sample)
        curves.append(_echo_density(one.rir[max(0, first - 4):first + 4800]))
        expected.append(_echo_density(_poisson_arrivals(first, 4800, rng)))
    hops = min(map(len, curves + expected))
    time_s = (np.arange(hops) * WINDOW / 4 + WINDOW / 2) / ours.FS_HZ
    return time_s, *(np.mean([curve[:hops] for curve in some], axis=0) for some in (curves, expected))


def _echo_density(signal):
    window = np.hanning(WINDOW + 2)[1:-1]
    window /= window.sum()
    density = []
    for start in range(0, len(signal) - WINDOW, WINDOW // 4):
        part = signal[start:start + WINDOW]
        deviation = np.sqrt(np.sum(window * part ** 2))
        density.append(np.sum(window * (np.abs(part) > deviation)) / GAUSSIAN_SHARE)
    return np.array(density)


def _poisson_arrivals(first, n_samples, rng):
    """Pulses of random sign at the rate of a room's reflections, decaying with 1 / t, as band-limited as ours."""
    time_s = (first + np.arange(n_samples)) / ours.FS_HZ
    rate = 4.0 * np.pi * 343.2 ** 3 * time_s ** 2 / np.prod(ROOM_M) / ours.FS_HZ
    count = rng.poisson(np.minimum(rate, 50.0))
    count[0] = 1
    return rng.standard_normal(n_samples) * np.sqrt(count) / time_s * np.where(count == 0, 0.0, 1.0)


def _spectrum(responses):
    """Mean power spectrum of the tails in third octaves, relative to their mean above 200 Hz."""
    n_fft = 32768
    power = np.zeros(n_fft // 2 + 1)
    for one in responses:
        tail = one.rir[int(LATE_S * one.fs_hz):][:n_fft]
        power += np.abs(np.fft.rfft(tail, n_fft)) ** 2 / np.sum(tail ** 2)
    frequency = np.fft.rfftfreq(n_fft, 1.0 / ours.FS_HZ)
    centers = 1000.0 * 2.0 ** (np.arange(-12, 10) / 3.0)
    centers = centers[centers < 7000.0]
    bands = [power[(frequency >= c * 2 ** (-1 / 6)) & (frequency < c * 2 ** (1 / 6))].mean() for c in centers]
    level_db = 10.0 * np.log10(np.array(bands))
    return centers, level_db - level_db[centers > 200.0].mean()


def draw(axis, section):
    """Echo density over time."""
    time_ms = 1e3 * np.array(section.curves["time_s"], dtype=float)
    axis.semilogx(time_ms, np.array(section.curves["density"], dtype=float), label="roomeq")
    axis.semilogx(time_ms, np.array(section.curves["expected"], dtype=float), ":", label="Poisson arrivals")
    axis.set(title="tail: echo density", xlabel="time after the direct sound (ms)", ylabel="over that of noise")
    axis.legend()
