"""What is read of a file to show: its channel, and the row that it has in an RIR directory."""

import numpy as np
import pytest
from rirmaker import DIRECT, coloured_rir, row

from roomeq.acoustics.parameters import measure
from roomeq.core.audio import write_wav
from roomeq.core.constants import FS_HZ
from roomeq.records.rir_dir import write_rirs
from roomeq.report.formats import DASH
from roomeq.show.inputs import read_rir_file, read_rir_of
from roomeq.show.tables import BAND_COLUMNS, band_rows, distance_of

LATER = 94
"""Samples by which the second microphone of the array hears the source later."""


@pytest.fixture
def array(tmp_path):
    """Write an RIR directory with one array of two microphones, 1 and 3 m from the source; return the file."""
    rir = coloured_rir(0)
    samples = np.column_stack([rir, np.concatenate([np.zeros(LATER), -rir[:-LATER]])])
    write_wav(tmp_path / "a.wav", samples, FS_HZ)
    write_rirs(tmp_path, [row("a", wav="a.wav", fs_hz=FS_HZ, n_samples=len(rir), source_pos_m=[1.0, 1.0, 1.0],
                              mic_pos_m=[2.0, 1.0, 1.0], channel_pos_m=[[2.0, 1.0, 1.0], [4.0, 1.0, 1.0]],
                              distance_m=1.0, seed=0, direct_sample=float(DIRECT), direct_polarity=1)])
    return tmp_path / "a.wav"


@pytest.mark.parametrize("channel, distance_m, sample, polarity", [(0, 1.0, DIRECT, 1), (1, 3.0, DIRECT + LATER, -1)])
def test_channel_of_an_array_has_its_own_position_and_direct_sound(array, channel, distance_m, sample, polarity):
    shown = read_rir_file(array, channel)
    assert distance_of(shown.row) == distance_m and shown.rir.direct.polarity == polarity
    assert shown.rir.direct.sample == pytest.approx(sample, abs=0.5)


def test_channel_without_a_stated_position_has_none(tmp_path):
    write_wav(tmp_path / "b.wav", np.column_stack([coloured_rir(0), coloured_rir(1)]), FS_HZ)
    write_rirs(tmp_path, [row("b", wav="b.wav", fs_hz=FS_HZ, n_samples=FS_HZ, source_pos_m=[1.0, 1.0, 1.0],
                              mic_pos_m=[2.0, 1.0, 1.0])])
    assert distance_of(read_rir_file(tmp_path / "b.wav", 0).row) == 1.0
    assert distance_of(read_rir_file(tmp_path / "b.wav", 1).row) is None


def test_values_that_the_row_calls_invalid_are_not_shown(tmp_path):
    """The row knows the excitation of all RIRs of the source."""
    rir = coloured_rir(0)
    write_wav(tmp_path / "c.wav", rir, FS_HZ)
    parameters = measure(rir)
    parameters["eq_valid"][0] = parameters["c50_valid"][0] = False
    write_rirs(tmp_path, [row("c", wav="c.wav", fs_hz=FS_HZ, n_samples=len(rir), acoustic_parameters=parameters)])
    columns = {name: BAND_COLUMNS.index(name) for name in ("C50 (dB)", "EQ (dB)")}
    cells = band_rows(read_rir_of(tmp_path, "c").rir)
    for at in columns.values():
        assert cells[0][at] == DASH and cells[1][at] != DASH
