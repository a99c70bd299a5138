"""Sound absorption of air, and how it wears a response off."""

import numpy as np

from testbed.draws import C0, FS_HZ

FRAME = 256  # samples: over half of it the air takes less than 0.3 dB at 8 kHz


def absorption_db_per_m(frequency_hz, temperature_c, humidity_pct):
    """Attenuation of a pure tone at one atmosphere [dB/m], ISO 9613-1:1993, eqs. 3 to 5 and B.1 to B.3."""
    f = np.asarray(frequency_hz, dtype=float)
    kelvin = temperature_c + 273.15
    warm = kelvin / 293.15
    saturation = 10.0 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261)
    h = humidity_pct * saturation  # molar concentration of water vapour [%]
    oxygen_hz = 24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h)
    nitrogen_hz = warm ** -0.5 * (9.0 + 280.0 * h * np.exp(-4.170 * (warm ** (-1.0 / 3.0) - 1.0)))
    relaxing = (0.01275 * np.exp(-2239.1 / kelvin) / (oxygen_hz + f ** 2 / oxygen_hz)
                + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen_hz + f ** 2 / nitrogen_hz))
    return 8.686 * f ** 2 * (1.84e-11 * np.sqrt(warm) + warm ** -2.5 * relaxing)


def through_air(rir, temperature_c, humidity_pct, c=C0):
    """Let every moment of a response have travelled through air as far as its delay says.

    Overlapping frames are filtered with the air's own response at each frequency, without phase.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        Sample 0 is the emission.
    temperature_c, humidity_pct : float
    c : float
        Speed of sound [m/s].
    """
    hop = FRAME // 2
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(FRAME) / FRAME)
    padded = np.pad(rir, (FRAME, FRAME + hop))
    n_frames = (len(padded) - FRAME) // hop + 1
    frames = np.lib.stride_tricks.sliding_window_view(padded, FRAME)[::hop][:n_frames]
    centre_s = (np.arange(n_frames) * hop + hop - FRAME) / FS_HZ
    lost_db = absorption_db_per_m(np.fft.rfftfreq(2 * FRAME, 1.0 / FS_HZ), temperature_c, humidity_pct)
    gains = 10.0 ** (-np.maximum(centre_s, 0.0)[:, None] * c * lost_db / 20.0)
    # half a frame of room on both sides for what the filter spreads
    spread = np.fft.irfft(np.fft.rfft(np.pad(frames * window, ((0, 0), (hop, hop)))) * gains)
    result = np.zeros(len(padded) + FRAME)
    for k, frame in enumerate(spread):
        result[k * hop:k * hop + 2 * FRAME] += frame
    start = FRAME + hop
    return result[start:start + len(rir)]
