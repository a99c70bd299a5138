"""Energies in bands against the frequency response of their filters."""

import numpy as np
import pytest

from roomeq.acoustics.band_energy import OCTAVES, THIRDS, energy_in_bands, energy_per_bin
from roomeq.core.constants import FS_HZ


@pytest.mark.parametrize("n_fft", [1, 2, 1000, 1001, 1002, 1003])
@pytest.mark.parametrize("bands", [OCTAVES, THIRDS], ids=["octaves", "thirds"])
def test_energy_in_bands_is_that_behind_the_filters(bands, n_fft):
    energy = energy_per_bin(np.random.default_rng(n_fft).standard_normal(n_fft), n_fft)
    frequency = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), 1e-3)
    ratio = frequency / bands.mid_hz[:, None]
    expected = (energy / (1.0 + (bands.quality * (ratio - 1.0 / ratio)) ** 8)).sum(axis=1)
    np.testing.assert_allclose(energy_in_bands(bands, energy, n_fft), expected, rtol=1e-10)
