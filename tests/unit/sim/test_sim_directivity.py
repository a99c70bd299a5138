"""Interpolation of measured directivities: the triangle that a direction lies in is found as by testing all."""

import numpy as np
import pytest
from scipy.special import eval_legendre

from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.effects.spherical_cap import cap_series
from roomeq.rooms import Loudspeaker
from roomeq.sim.directivity import DirectivityTable

FS_HZ = 16000


def on_sphere(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def random(n, seed=0):
    return on_sphere(np.random.default_rng(seed).standard_normal((n, 3)))


def lattice(step_deg, lowest_deg, highest_deg):
    """Return the directions of a turntable; at a pole, one for each azimuth."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, step_deg)),
                                     np.radians(np.arange(lowest_deg, highest_deg + 1, step_deg)))
    return np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)],
                    axis=-1).reshape(-1, 3)


def of_all_triangles(table, directions):
    """Return the gains in one band, shape (n,), from the triangle in which the least weight is the largest of all."""
    corners, inverses, _ = table._triangles
    weights = np.einsum("fij,nj->nfi", inverses, directions)
    inside = weights.min(axis=2).argmax(axis=1)
    weight = np.maximum(weights[np.arange(len(inside)), inside], 0.0)
    gain = 10.0 ** (0.05 * table.gains_db[:, 0])
    return np.sum(weight * gain[corners[inside]], axis=1) / weight.sum(axis=1)


@pytest.mark.parametrize("grid", [
    lattice(10, -90, 90), lattice(10, -80, 80), lattice(5, -90, 90), lattice(5, -30, 90), random(300), random(2000),
    np.concatenate([random(40), on_sphere(0.05 * random(400, 1) + [1.0, 0.0, 0.0])]),
    np.concatenate([np.eye(3), -np.eye(3)]), np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]),
    np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3),
], ids=["10 degrees", "no poles", "5 degrees", "no floor", "300", "2000", "cluster", "octahedron", "tetrahedron",
        "cube"])
def test_gains_are_those_of_the_best_of_all_triangles(grid):
    gains_db = np.random.default_rng(2).uniform(-20.0, 10.0, (len(grid), 1))
    table = DirectivityTable(grid, [1000.0], gains_db, (1.0, 0.0, 0.0))
    measured = table.directions[:200]
    between = on_sphere(measured[1:] + 1.001 * measured[:-1])
    asked = np.concatenate([random(500, 3), measured, between, np.eye(3), -np.eye(3)])
    found = table.pressure(asked, FS_HZ)
    assert found.shape == (len(asked), 8)
    assert np.abs(found - of_all_triangles(table, asked)[:, None]).max() < 1e-9


def arc(first_deg, last_deg, about_deg=0):
    """Return directions every 10 degrees from the axis, in a plane through it."""
    angle, about = np.radians(np.arange(first_deg, last_deg + 1, 10)), np.radians(about_deg)
    return np.stack([np.cos(angle), np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about)], axis=-1)


@pytest.mark.parametrize("polar", [arc(-180, 170), arc(0, 180), arc(-180, 170, 90), arc(0, 180, -30),
                                   np.concatenate([arc(-180, 170), arc(-180, 170, 90)])],
                         ids=["horizontal", "half", "vertical", "oblique", "both"])
def test_polar_diagrams_of_a_loudspeaker_are_turned_about_its_axis(polar):
    speaker, asked = Loudspeaker((1.0, 0.0, 0.0)), random(5000)
    table = DirectivityTable(polar, EXACT_BANDS_HZ, 20.0 * np.log10(speaker.pressure(polar, FS_HZ)), (1.0, 0.0, 0.0))
    found, expected = table.pressure(asked, FS_HZ), speaker.pressure(asked, FS_HZ)
    assert 10.0 * np.log10(np.mean(found ** 2, axis=0) / np.mean(expected ** 2, axis=0)) == pytest.approx(0.0, abs=0.05)
    assert np.sqrt(np.mean((20.0 * np.log10(found / expected)) ** 2)) < 0.4
    assert table.pressure(polar, FS_HZ) == pytest.approx(speaker.pressure(polar, FS_HZ))


def test_sides_of_a_polar_diagram_may_differ():
    """As of a first-order pattern that faces 40 degrees to the left of the axis; straight up is 90 degrees from it."""
    polar, facing = arc(-180, 170), np.array([np.cos(np.radians(40)), np.sin(np.radians(40)), 0.0])
    table = DirectivityTable(polar, [1000.0], 20.0 * np.log10(0.55 + 0.45 * polar @ facing)[:, None], (1.0, 0.0, 0.0))
    asked = np.concatenate([random(500), np.eye(3), -np.eye(3)])
    assert table.pressure(asked, FS_HZ)[:, 0] == pytest.approx(0.55 + 0.45 * asked @ facing, abs=0.01)


@pytest.mark.parametrize("fs_hz", [16000, 48000])
def test_octaves_have_the_mean_energy_of_the_frequencies_in_them(fs_hz):
    """Off the axis, the middle of the octaves at 4 and 8 kHz lies in notches, up to 20 dB lower than the octave."""
    frequencies_hz, polar = 1000.0 * 2.0 ** (np.arange(-54, 55) / 12.0), arc(0, 180)
    series = cap_series(0.1, np.arcsin(0.5), frequencies_hz)
    pressure = series @ np.array([eval_legendre(n, polar[:, 0]) for n in range(series.shape[1])])
    gains_db = 20.0 * np.log10(np.abs(pressure / series.sum(axis=1)[:, None])).T
    table = DirectivityTable(polar, frequencies_hz, gains_db, (1.0, 0.0, 0.0))
    error_db = 20.0 * np.log10(table.pressure(polar, fs_hz) / Loudspeaker((1.0, 0.0, 0.0)).pressure(polar, fs_hz))
    assert np.abs(error_db).max() < 2.0


def test_no_directions_have_no_gains():
    table = DirectivityTable(lattice(10, -90, 90), [1000.0], np.zeros((684, 1)), (1.0, 0.0, 0.0))
    assert table.pressure(np.zeros((0, 3)), FS_HZ).shape == (0, 8)


def test_measured_directions_have_their_gains():
    """Also the poles, where each azimuth has the same."""
    grid = lattice(10, -90, 90)
    gains_db = 20.0 * np.log10(0.55 + 0.45 * grid)[:, 2:]
    table = DirectivityTable(grid, [1000.0], gains_db, (1.0, 0.0, 0.0))
    assert table.pressure(grid, FS_HZ)[:, 0] == pytest.approx(10.0 ** (0.05 * gains_db[:, 0]), abs=1e-9)
