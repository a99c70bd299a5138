"""Directivities from SOFA files."""

import numpy as np
import pytest

import roomeq

sofar = pytest.importorskip("sofar")
netCDF4 = pytest.importorskip("netCDF4")

AZIMUTH, ELEVATION = (grid.ravel() for grid in np.meshgrid(np.arange(0, 360, 10), np.arange(-90, 91, 10)))
FREQUENCIES_HZ = np.arange(50.0, 20000.0, 50.0)


def cosine():
    return np.cos(np.deg2rad(AZIMUTH)) * np.cos(np.deg2rad(ELEVATION))


def write_tf(path, gain, frequencies_hz=FREQUENCIES_HZ, view=(1, 0, 0), up=(0, 0, 1)):
    sofa = sofar.Sofa("FreeFieldDirectivityTF")
    on_axis = np.exp(-1j * frequencies_hz / 300.0) * (1.0 + frequencies_hz / 1000.0)
    response = np.reshape(gain, (len(AZIMUTH), -1)) * on_axis
    sofa.Data_Real, sofa.Data_Imag = response.real[None], response.imag[None]
    sofa.N = frequencies_hz
    sofa.protected = False
    for name in ("EmitterDescriptions", "Description"):  # empty texts cannot be written
        sofa.delete(name)
    sofa.protected = True
    sofa.SourceView, sofa.SourceUp = np.array([view], float), np.array([up], float)
    sofa.ReceiverPosition = np.stack([AZIMUTH, ELEVATION, np.ones(len(AZIMUTH))], axis=1)
    sofar.write_sofa(str(path), sofa)
    return path


def test_measured_cardioid_acts_as_one_relative_to_its_axis(tmp_path):
    table = roomeq.read_directivity(write_tf(tmp_path / "c.sofa", 3.0 * (0.5 + 0.5 * cosine())), facing=(0, 1, 0))
    directions = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1], [0.6, -0.8, 0]], dtype=float)
    expected = roomeq.FirstOrder("cardioid", (0, 1, 0)).pressure(directions, 48000)
    assert table.pressure(directions, 48000) == pytest.approx(expected, abs=0.05)


def test_gain_of_the_highest_octave_is_that_of_its_recorded_part(tmp_path):
    """A device that radiates to all sides up to 8 kHz, and above only ahead."""
    gain = np.where((FREQUENCIES_HZ < 8000.0) | (cosine()[:, None] > 0.5), 1.0, 0.01)
    table = roomeq.read_directivity(write_tf(tmp_path / "high.sofa", gain), facing=(1, 0, 0))
    behind = np.array([[-1.0, 0.0, 0.0]])
    assert table.pressure(behind, 16000)[0, 7] > 0.85 and table.pressure(behind, 48000)[0, 7] < 0.65


def test_up_turns_the_device_about_its_axis(tmp_path):
    """The gain is high above the device: with `up` along y it is high in that direction of the room."""
    path = write_tf(tmp_path / "up.sofa", 1.0 + 0.9 * np.sin(np.deg2rad(ELEVATION)))
    table = roomeq.read_directivity(path, facing=(1, 0, 0), up=(0, 1, 0))
    above, below = table.pressure(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]), 16000)[:, 4]
    assert above > 1.7 and below < 0.3


def test_main_axis_is_what_the_file_states(tmp_path):
    """A device that the file lays on its side, its front along y: it is loudest ahead, and softest on its left."""
    gain = 1.0 + 0.5 * np.sin(np.deg2rad(AZIMUTH)) * np.cos(np.deg2rad(ELEVATION)) + 0.4 * np.sin(np.deg2rad(ELEVATION))
    path = write_tf(tmp_path / "view.sofa", gain, view=(0, 1, 0), up=(1, 0, 0))
    table = roomeq.read_directivity(path, facing=(1, 0, 0))
    ahead, left, up = table.pressure(np.eye(3), 16000)[:, 4]
    # the device's left is up x ahead = (1, 0, 0) x (0, 1, 0) = z of the file, its top is x
    assert [ahead, left, up] == pytest.approx([1.0, 1.4 / 1.5, 1.0 / 1.5], abs=0.02)
    with pytest.raises(ValueError, match="must point in two different directions"):
        roomeq.read_directivity(write_tf(tmp_path / "flat.sofa", gain, view=(0, 0, 1)), facing=(1, 0, 0))


def test_directions_in_radians_or_without_coordinates_are_recognised(tmp_path):
    path = write_tf(tmp_path / "radians.sofa", 0.5 + 0.5 * cosine())
    with netCDF4.Dataset(path, "a") as file:
        file["ReceiverPosition"][:, :2] = np.deg2rad(file["ReceiverPosition"][:, :2])
        file["ReceiverPosition"].Units = "radian, radian, metre"
    ahead, left, behind = roomeq.read_directivity(path, (1, 0, 0)).pressure(
        np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0]]), 16000)[:, 4]
    assert [ahead, left, behind] == pytest.approx([1.0, 0.5, 0.0], abs=0.02)
    with netCDF4.Dataset(path, "a") as file:
        file["ReceiverPosition"].Type = "spherical harmonics"
    with pytest.raises(ValueError, match="must hold finite vectors in Cartesian or spherical coordinates"):
        roomeq.read_directivity(path, (1, 0, 0))


def test_files_that_hold_no_directivity_are_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot be read as SOFA"):
        (tmp_path / "x.sofa").write_bytes(b"no")
        roomeq.read_directivity(tmp_path / "x.sofa", facing=(1, 0, 0))
    with pytest.raises(ValueError, match="measurement 1 of 1"):
        roomeq.read_directivity(write_tf(tmp_path / "c.sofa", np.ones(len(AZIMUTH))), (1, 0, 0), measurement=1)
    with pytest.raises(ValueError, match="no frequency lies in an octave"):
        roomeq.read_directivity(write_tf(tmp_path / "f.sofa", np.ones(len(AZIMUTH)), np.array([1.0, 2.0])), (1, 0, 0))
