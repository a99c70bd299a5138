"""The sum of a room's modes against image sources, closed forms and itself, and its crossover to rays."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from bench.rooms import FURNISHED_M, L_HEIGHT_M, box_triangles, furnished_triangles, l_triangles
from roomeq.core.constants import FS_HZ
from roomeq.effects.voxels import mode_count, voxel_modes
from roomeq.effects.wavefield import (
    HIGHPASS_HZ,
    MARGIN,
    MAX_CROSSOVER_HZ,
    MAX_MESH_MODES,
    MAX_MODES,
    Modes,
    cross_over,
    crossover_hz,
    damping_per_s,
    modal_response,
    modes,
)
from roomeq.sim.mesh import make_room
from roomeq.sim.scene import Air, Shoebox

C = Air().speed_m_s
DIMS_M = (5.2, 4.1, 2.7)
BOX = Shoebox(DIMS_M)
THIRDS_HZ = 1000.0 * 10.0 ** (0.1 * np.arange(-16, -6))  # 25 to 200 Hz
FINE_HZ = 64000  # image sources fall on samples of this rate


def inside(rng, clearance_m=0.3, dims_m=DIMS_M):
    return rng.uniform(clearance_m, np.array(dims_m) - clearance_m)


def voxels_of(room, f_max_hz):
    k, shapes = voxel_modes(room, 2.0 * np.pi * f_max_hz / C)
    return Modes(C * k / (2.0 * np.pi), f_max_hz, room.volume_m3, C, shapes)


def third_octaves_db(rir, fs_hz, frequencies_hz=THIRDS_HZ):
    """Mean energy in third octaves, with the second half of the response faded out."""
    rir = rir.copy()
    half = len(rir) // 2
    rir[-half:] *= np.cos(np.linspace(0.0, 0.5 * np.pi, half)) ** 2
    n_fft = 4 * fs_hz
    energy = np.abs(np.fft.rfft(rir, n_fft)) ** 2
    grid_hz = np.fft.rfftfreq(n_fft, 1.0 / fs_hz)
    return np.array([10.0 * np.log10(energy[np.abs(np.log2(np.maximum(grid_hz, 1e-3) / f)) <= 1.0 / 6.0].mean())
                     for f in frequencies_hz])


def image_sum(source, mic, reflection, length_s):
    """Sum of all image sources of a shoebox with one pressure reflection coefficient, at `FINE_HZ`."""
    reach_m, axes = C * length_s, []
    for size, s, m in zip(DIMS_M, source, mic, strict=True):
        n = np.arange(-int(0.5 * reach_m / size) - 1, int(0.5 * reach_m / size) + 2)
        axes.append((np.r_[2 * n * size + s - m, 2 * n * size - s - m], np.r_[abs(2 * n), abs(2 * n - 1)]))
    (x, in_x), (y, in_y), (z, in_z) = axes
    rir = np.zeros(int(length_s * FINE_HZ) + 1)
    for offset, order in zip(x, in_x, strict=True):
        distance = np.sqrt(offset ** 2 + np.add.outer(y ** 2, z ** 2))
        level = reflection ** (order + np.add.outer(in_y, in_z)) / (4.0 * np.pi * distance)
        near = distance < reach_m
        rir += np.bincount(np.rint(distance[near] / C * FINE_HZ).astype(int), level[near], minlength=len(rir))
    return sosfilt(butter(2, HIGHPASS_HZ, "highpass", fs=FINE_HZ, output="sos"), rir)


@pytest.fixture(scope="module")
def box_modes():
    return modes(BOX, 450.0, C)


@pytest.fixture(scope="module")
def mesh_modes():
    """Of voxels, although the room is a prism."""
    return voxels_of(make_room(box_triangles(DIMS_M), ["wall"] * 12), 300.0)


@pytest.fixture(scope="module")
def prism_modes():
    return modes(make_room(box_triangles(DIMS_M), ["wall"] * 12), 300.0, C)


@pytest.mark.parametrize("case, distance_m", list(enumerate([None, None, None, None, 0.2, 0.3, 0.5, 1.5])))
@pytest.mark.parametrize("f_max_hz", [300.0, 450.0])
def test_levels_match_the_sum_of_all_image_sources(case, distance_m, f_max_hz):
    """Levels in a nearly rigid room agree within 1 dB, near the source and far from it."""
    rng, length_s, reflection = np.random.default_rng(case), 0.35, 0.995
    source = inside(rng, 0.4)
    way = np.array(DIMS_M) / 2.0 - source
    mic = inside(rng) if distance_m is None else source + distance_m * way / np.linalg.norm(way)
    walls_m2 = BOX.surface_area_m2.sum()
    damping = -np.log(reflection) * C * walls_m2 / (4.0 * BOX.volume_m3)  # mean free path 4 V / S
    response = modal_response(modes(BOX, f_max_hz, C), source, mic, damping, int(length_s * FS_HZ), FS_HZ)
    expected = image_sum(source, mic, reflection, length_s)
    np.testing.assert_allclose(third_octaves_db(response, FS_HZ), third_octaves_db(expected, FINE_HZ), atol=1.0)


def test_response_is_reciprocal(box_modes, mesh_modes):
    rng = np.random.default_rng(0)
    source, mic = inside(rng), inside(rng)
    for room_modes in (box_modes, mesh_modes):
        there = modal_response(room_modes, source, mic, 7.0, 4000, FS_HZ)
        np.testing.assert_array_equal(there, modal_response(room_modes, mic, source, 7.0, 4000, FS_HZ))


def test_response_is_a_sum_of_damped_sines(box_modes):
    source, mic, n_samples = (1.0, 1.2, 1.1), (4.0, 3.0, 1.6), 3001
    damping = np.linspace(5.0, 9.0, len(box_modes.frequencies_hz))
    response = modal_response(box_modes, source, mic, damping, n_samples, FS_HZ)
    without = modal_response(box_modes, source, mic, damping * np.where(np.arange(len(damping)) == 30, 1e9, 1.0),
                             n_samples, FS_HZ)
    time_s, omega = np.arange(n_samples) / FS_HZ, 2.0 * np.pi * box_modes.frequencies_hz[30]
    level = C ** 2 / BOX.volume_m3 / FS_HZ * box_modes.shapes(source)[30] * box_modes.shapes(mic)[30]
    sine = level * np.exp(-damping[30] * time_s) * np.sin(omega * time_s) / omega
    expected = sosfilt(butter(2, HIGHPASS_HZ, "highpass", fs=FS_HZ, output="sos"), sine)
    np.testing.assert_allclose(response - without, expected, atol=1e-9 * np.abs(level / omega))


def test_response_has_no_constant_part(box_modes):
    rir = modal_response(box_modes, (1.0, 1.2, 1.1), (4.0, 3.0, 1.6), 7.0, 2 * FS_HZ, FS_HZ)
    spectrum = np.abs(np.fft.rfft(rir))
    assert spectrum[0] < 1e-3 * spectrum.max()
    assert np.sum(rir[-FS_HZ // 10:] ** 2) < 1e-8 * np.sum(rir ** 2)


def test_shoebox_mode_shapes_are_normalised(box_modes):
    grid = [(np.arange(40) + 0.5) / 40 * size for size in DIMS_M]
    index = box_modes.shapes.index
    chosen = [0, 5, 40, len(index) - 1]
    points = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    squares = np.mean([box_modes.shapes(point)[chosen] ** 2 for point in points[::7]], axis=0)
    np.testing.assert_allclose(squares, 1.0, atol=0.02)


def test_damping_interpolates_between_bands():
    t60_s = np.array([1.0, 0.8, 0.5, 0.5, 0.5, 0.5, 0.4, 0.3])
    damping = damping_per_s([10.0, 63.0957, 125.8925, 90.0], t60_s)
    np.testing.assert_allclose(damping[:3], 3.0 * np.log(10.0) / np.array([1.0, 1.0, 0.8]), rtol=1e-4)
    assert damping[1] < damping[3] < damping[2]


@pytest.mark.parametrize("kind, rtol", [("mesh_modes", 0.005), ("prism_modes", 0.001)])
def test_voxels_of_a_box_have_its_eigenfrequencies(kind, rtol, request):
    exact, found_hz = modes(BOX, 320.0, C).frequencies_hz, request.getfixturevalue(kind).frequencies_hz
    assert len(found_hz) == pytest.approx(np.sum(exact <= 300.0), abs=4)
    np.testing.assert_allclose(found_hz, exact[:len(found_hz)], rtol=rtol)


@pytest.mark.parametrize("angle_rad", [0.15, 0.3, 0.6])
def test_voxels_of_an_oblique_box_have_its_eigenfrequencies(angle_rad):
    """Walls that cut voxels are where they are: steps as large as a voxel would shift the modes by 3 to 4 %."""
    x, y = np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])
    turned = make_room(box_triangles(DIMS_M) @ np.array([[*x, 0.0], [*y, 0.0], [0.0, 0.0, 1.0]]), ["wall"] * 12)
    found, exact = voxels_of(turned, 150.0).frequencies_hz, modes(BOX, 160.0, C).frequencies_hz
    assert len(found) == pytest.approx(np.sum(exact <= 150.0), abs=1)
    assert np.sqrt(np.mean((found / exact[:len(found)] - 1.0) ** 2)) < 0.01



@pytest.mark.parametrize("kind", ["mesh_modes", "prism_modes"])
def test_voxels_of_a_box_give_its_response(kind, request):
    """Levels agree below 200 Hz, where modes are so far apart that their order is the same."""
    rng = np.random.default_rng(2)
    exact, of_voxels = modes(BOX, 300.0, C), request.getfixturevalue(kind)
    differences = []
    for _ in range(6):
        source, mic = inside(rng), inside(rng)
        mesh, box = (modal_response(m, source, mic, 7.0, FS_HZ // 2, FS_HZ) for m in (of_voxels, exact))
        differences.append(third_octaves_db(mesh, FS_HZ) - third_octaves_db(box, FS_HZ))
    assert np.sqrt(np.mean(np.square(differences))) < 1.0


def test_voxel_mode_shapes_are_normalised_up_to_the_walls(mesh_modes):
    shapes = mesh_modes.shapes
    np.testing.assert_allclose(np.mean(shapes.values ** 2, axis=0), 1.0, rtol=1e-4)
    middle = shapes.origin_m + (np.array([3, 4, 2]) + 0.5) * shapes.size_m
    np.testing.assert_allclose(shapes(middle), shapes.values[shapes.number[3, 4, 2]], atol=1e-4)
    corner = shapes(np.array([0.02, 0.02, 0.02]))
    np.testing.assert_allclose(corner, shapes.values[shapes.number[0, 0, 0]], atol=1e-5)


def test_modes_of_an_l_shape_converge_with_voxel_size():
    """The modes include that of the room's height."""
    room = make_room(*l_triangles())
    k = [voxel_modes(room, 2.0 * np.pi * 100.0 / C, per_wavelength)[0][:12] for per_wavelength in (6.0, 12.0, 24.0)]
    errors = [np.abs(row / k[2] - 1.0).max() for row in k[:2]]
    assert errors[0] < 0.01 and errors[1] < 0.5 * errors[0]
    np.testing.assert_allclose(np.abs(k[2] / (np.pi / L_HEIGHT_M) - 1.0).min(), 0.0, atol=1e-3)


def test_prism_has_the_modes_of_its_voxels():
    """An L-shaped plan: frequencies, and the products of shapes that make a response."""
    room = make_room(*l_triangles())
    flat = modes(room, 60.0, C)
    k, shapes = voxel_modes(room, 2.0 * np.pi * 60.0 / C, 24.0)
    np.testing.assert_allclose(flat.frequencies_hz, C * k / (2.0 * np.pi), rtol=3e-3)
    low, high = room.bounds_m
    source, mic = low + 0.1 * (high - low), low + [0.15, 0.2, 0.8] * (high - low)
    levels = [np.sum(each(source) * each(mic)) for each in (flat.shapes, shapes)]
    assert levels[0] == pytest.approx(levels[1], rel=0.05)


def test_prism_stands_on_its_floor():
    """A room that does not begin at height 0 has the modes and the response of one that does."""
    triangles, names = l_triangles()
    both = [modes(make_room(triangles + [0.0, 0.0, z], names), 100.0, C) for z in (0.0, -1.7)]
    np.testing.assert_allclose(both[1].frequencies_hz, both[0].frequencies_hz, rtol=1e-5)
    source, mic = np.array([1.0, 1.2, 1.1]), np.array([2.0, 1.0, 1.6])
    here, there = (modal_response(m, source + [0.0, 0.0, z], mic + [0.0, 0.0, z], 7.0, 4000, FS_HZ)
                   for m, z in zip(both, (0.0, -1.7), strict=True))
    np.testing.assert_allclose(there, here, atol=1e-3 * np.abs(here).max())


def test_wall_thinner_than_a_voxel_separates():
    """Around a plate with a gap, sound takes a longer path in the lowest mode, and both sides have opposite signs."""
    dims_m, plate = (6.0, 3.0, 3.0), box_triangles((0.02, 2.0, 3.0 - 2e-3), (3.0, 1e-3, 1e-3))
    room = make_room(np.concatenate([box_triangles(dims_m), plate]), ["wall"] * 24)
    room_modes = modes(room, 150.0, C)
    free_hz = C / 12.0
    assert room_modes.frequencies_hz[0] < 0.9 * free_hz
    left, right = (room_modes.shapes((3.01 + side * 0.05, 1.0, 1.5))[0] for side in (-1.0, 1.0))
    assert left * right < 0.0 and min(abs(left), abs(right)) > 0.3


def test_furniture_shifts_eigenfrequencies_little():
    room = make_room(*furnished_triangles())
    furnished_hz = modes(room, 80.0, C).frequencies_hz
    bare_hz = modes(Shoebox(FURNISHED_M), 80.0, C).frequencies_hz
    np.testing.assert_allclose(furnished_hz[:5], bare_hz[:5], rtol=0.02)


def test_too_many_voxels_raise_value_error():
    with pytest.raises(ValueError, match="voxels and may have"):
        voxels_of(make_room(box_triangles((40.0, 30.0, 10.0)), ["wall"] * 12), 300.0)


def test_crossover_is_the_limited_schroeder_frequency():
    big = Shoebox((12.0, 8.0, 4.0))
    assert crossover_hz(big, [1.0] * 8, C) == pytest.approx(2000.0 * np.sqrt(1.0 / 384.0), rel=1e-3)
    assert crossover_hz(Shoebox((3.0, 2.5, 2.4)), [1.0] * 8, C) == MAX_CROSSOVER_HZ
    falling = crossover_hz(big, [4.0, 2.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5], C)
    assert crossover_hz(big, [0.5] * 8, C) < falling < crossover_hz(big, [2.0] * 8, C)
    prism = make_room(box_triangles(big.dims_m), ["wall"] * 12)
    desk = box_triangles((2.0, 1.0, 0.7), (4.0, 3.0, 0.5))
    mesh = make_room(np.concatenate([box_triangles(big.dims_m), desk]), ["wall"] * 24)
    for room, max_modes in ((mesh, MAX_MESH_MODES), (prism, MAX_MODES), (big, MAX_MODES)):
        limited_hz = crossover_hz(room, [9.0] * 8, C)
        assert limited_hz < 2000.0 * np.sqrt(9.0 / 384.0)
        assert mode_count(room, 2.0 * np.pi * MARGIN * limited_hz / C) == pytest.approx(max_modes, rel=1e-3)


def test_response_crossed_over_with_itself_is_unchanged():
    rir = np.random.default_rng(0).standard_normal(5000)
    np.testing.assert_allclose(cross_over(rir, rir, FS_HZ, 150.0), rir, atol=1e-12)


@pytest.mark.parametrize("frequency_hz", [80.0, 200.0])
def test_crossover_keeps_the_energy_of_unrelated_responses(frequency_hz):
    rng = np.random.default_rng(1)
    thirds_hz = frequency_hz * 2.0 ** (np.arange(-6, 7) / 3.0)
    change_db = np.zeros(len(thirds_hz))
    n_pairs = 60
    for _ in range(n_pairs):
        low, high = rng.standard_normal((2, 2 * FS_HZ))
        change_db += third_octaves_db(cross_over(low, high, FS_HZ, frequency_hz), FS_HZ, thirds_hz) / n_pairs
        change_db -= 0.5 / n_pairs * sum(third_octaves_db(rir, FS_HZ, thirds_hz) for rir in (low, high))
    assert np.abs(change_db).max() < 0.5


def test_crossover_suppresses_each_response_beyond_it():
    pulse, nothing = np.zeros(FS_HZ), np.zeros(FS_HZ)
    pulse[4000] = 1.0
    for low, high, kept_hz, gone_hz in ((pulse, nothing, 70.0, 240.0), (nothing, pulse, 240.0, 70.0)):
        level_db = third_octaves_db(cross_over(low, high, FS_HZ, 130.0), FS_HZ, [kept_hz, gone_hz])
        assert level_db[0] == pytest.approx(0.0, abs=0.1) and level_db[1] < -40.0


def test_modes_have_the_mean_level_of_a_diffuse_field(box_modes):
    """The mean energy is ``c / (8 pi V d)``, increased by the excess at the walls (Waterhouse)."""
    rng, damping = np.random.default_rng(3), 3.0 * np.log(10.0) / 0.6
    edges_hz = np.array([[140.0, 178.0], [178.0, 224.0], [140.0, 280.0]])
    energy, n_pairs = np.zeros(len(edges_hz)), 150
    for _ in range(n_pairs):
        rir = modal_response(box_modes, inside(rng, 0.0), inside(rng, 0.0), damping, FS_HZ, FS_HZ)
        spectrum = np.abs(np.fft.rfft(rir)) ** 2
        energy += [spectrum[int(low):int(high)].mean() / n_pairs for low, high in edges_hz]
    diffuse = C / (8.0 * np.pi * BOX.volume_m3 * damping)
    at_walls = 1.0 + BOX.surface_area_m2.sum() * C / (8.0 * BOX.volume_m3 * edges_hz.mean(axis=1))
    np.testing.assert_allclose(10.0 * np.log10(energy / (diffuse * at_walls)), 0.0, atol=1.0)


def test_crossover_changes_nothing_before_the_direct_sound():
    high, low = np.zeros((2, FS_HZ))
    high[800], low[1000] = 1.0, 1.0
    crossed = cross_over(low, high, FS_HZ, 60.0, 800 / FS_HZ)
    np.testing.assert_array_equal(crossed[:800], 0.0)
    assert np.abs(crossed[801:]).max() > 3e-3
