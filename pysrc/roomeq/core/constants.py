"""Numbers that every package uses: the sample rate, and the octave bands that all values per band refer to."""

FS_HZ = 16000
"""Sample rate of all speech, RIRs and noises inside the toolkit [Hz] (the paper's; LibriSpeech's)."""

BANDS_HZ = (62.5, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
"""Nominal mid-band frequencies of the eight octave bands [Hz]; also the paper's eight EQ sample points."""

EXACT_BANDS_HZ = tuple(1000.0 * 10.0 ** (0.3 * k) for k in range(-4, 4))
"""Exact mid-band frequencies [Hz], base ten (IEC 61260-1): 63.1, 125.9, ... 7943."""

BAND_1KHZ = 4
"""Index of the 1 kHz band: the reference of every EQ, and the band of every T60 target."""
