"""Edge diffraction: against the exact half-plane, across the shadow boundary, and in rooms."""

import math
from functools import partial

import numpy as np
import pytest
import trimesh
from plans import L_PLAN, box_plan, prism_obj
from scipy.special import h1vp, hankel1, jvp

from bench.fidelity import halfplane
from bench.fidelity.halfplane import at
from roomeq.acoustics.decibels import power_db
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import octave_energies
from roomeq.rooms import Loudspeaker
from roomeq.sim.diffraction import Edges, Grid, deposit, diffract, find_edges
from roomeq.sim.mesh import load_mesh, make_room
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Air, Material, Scene, Shoebox

C = Air().speed_m_s
FREQUENCIES_HZ = np.array([100.0, 200.0, 400.0, 800.0, 1500.0, 3000.0, 4500.0, 6000.0])


def wedge(open_deg, length_m=400.0):
    """An edge along z, its first face in the half-plane y = 0, x > 0, the air from there over y > 0."""
    x, y, z = np.eye(3)
    return Edges(np.array([-0.5 * length_m * z]), z[None], np.array([length_m]), x[None], y[None],
                 np.radians([open_deg]), np.zeros((1, 2), dtype=int), np.array([[0, 1]]))


def diffracted(edges, low_m, high_m, source, mic, visible=True, directions=False):
    """Diffraction at stretches of the one edge."""
    grid = Grid.between(np.linalg.norm(source - mic), 1.1 * edges.length_m[0] + 20.0, 1, C / FS_HZ, 10 ** 6, directions)
    deposit(grid, edges, np.zeros(len(low_m), dtype=int), low_m, high_m, source, mic, direct_visible=visible)
    return grid.sampled()


def wedge_spectrum(edges, source, mic, frequencies_hz, rows=slice(None), visible=True):
    """Diffraction at all of an edge, faces rigid, at some frequencies."""
    found = diffracted(edges, np.zeros(1), edges.length_m, source, mic, visible)
    time_s = (found.first_sample + np.arange(found.signals.shape[1])) / FS_HZ
    return np.exp(-2j * np.pi * np.outer(frequencies_hz, time_s)) @ found.signals[rows].sum(axis=0)


CASES = [(30.0, 100.0, 0.0), (60.0, 300.0, 0.0), (60.0, 250.0, 0.7), (60.0, 240.5, 0.7), (60.0, 239.5, 0.7),
         (60.0, 121.0, 0.0), (60.0, 119.0, 0.4), (135.0, 345.0, 0.0), (80.0, 275.0, -1.1), (20.0, 180.0, 0.0)]


@pytest.mark.parametrize("source_deg, mic_deg, z_m", CASES)
def test_rigid_half_plane_matches_exact_field(source_deg, mic_deg, z_m):
    source, mic = at(1.7, source_deg), at(2.3, mic_deg, z_m)
    exact = halfplane.exact(source, mic, FREQUENCIES_HZ, C)
    total = wedge_spectrum(wedge(360.0), source, mic, FREQUENCIES_HZ)
    total += halfplane.geometric(source, mic, FREQUENCIES_HZ, C)
    np.testing.assert_allclose(20.0 * np.log10(np.abs(total / exact)), 0.0, atol=0.5)


def test_field_is_continuous_across_shadow_boundary():
    """A wedge of 270 degrees, source at 60: the direct sound ends at 240, the reflection at 120."""
    frequencies_hz = np.array([250.0, 1000.0, 4000.0])
    edges, source = wedge(270.0, 20.0), at(1.7, 60.0)

    def level_db(angle_deg, visible=True):
        mic = at(2.3, angle_deg)
        total = halfplane.geometric(source, mic, frequencies_hz, C)
        return 20.0 * np.log10(np.abs(total + wedge_spectrum(edges, source, mic, frequencies_hz, visible=visible)))

    for boundary_deg in (120.0, 240.0):
        below, above = level_db(boundary_deg - 1e-3), level_db(boundary_deg + 1e-3)
        np.testing.assert_allclose(below, above, atol=0.02)
    right_on = at(2.3, 240.0)
    for visible in (True, False):
        direct = visible * np.exp(-2j * np.pi * frequencies_hz / C * 4.0) / (16.0 * np.pi)
        total = direct + wedge_spectrum(edges, source, right_on, frequencies_hz, visible=visible)
        np.testing.assert_allclose(20.0 * np.log10(np.abs(total)), level_db(239.999), atol=0.05)


@pytest.mark.parametrize("axis", [0, 1])
def test_reflection_is_continuous_at_its_boundary(axis, tmp_path):
    """A wall's reflection meets the wall at its free edge, exactly or nearly: with diffraction it does not jump."""
    (tmp_path / "room.obj").write_text(prism_obj(L_PLAN, 3.0))
    room = load_mesh(tmp_path / "room.obj")
    scene = Scene(room, [Material("wall", 0.1, 0.0)] * len(room.surfaces))

    def echo(shift_m, diffraction):
        positions = [np.roll([distance_m, 2.0 + shift_m], axis) for distance_m in (1.0, 0.5)]
        source, mic = [*positions[0], 1.5], [*positions[1], 1.7]
        responses = [response for seed in range(3) for response in simulate_responses(
            scene, source, mic, num_rays=1, ism_order=1, diffraction=diffraction, seed=seed)]
        image = [*np.roll([3.0, 2.0 + shift_m], axis), 1.5]
        at = responses[0].direct_sample + FS_HZ / scene.air.speed_m_s * (
            math.dist(image, mic) - math.dist(source, mic))
        echoes = [response.rir[round(at) - 12:round(at) + 13] for response in responses]
        # the median, as a single ray may pass the microphone close to the echo; the lowest frequencies of what arrived
        # before lie beneath
        return np.median([echo.max() - 0.5 * (echo[0] + echo[-1]) for echo in echoes])

    shifts_m = (-1e-3, -1e-5, -1e-7, -1e-12, 0.0, 1e-12, 1e-7, 1e-3)
    np.testing.assert_allclose([echo(shift_m, True) for shift_m in shifts_m], echo(1e-3, True), rtol=0.01)
    assert abs(echo(1e-3, False) - echo(-1e-3, False)) > abs(echo(1e-3, True))


def test_diffraction_is_reciprocal():
    edges, source, mic = wedge(300.0, 4.0), at(1.2, 40.0, -0.3), at(2.9, 260.0, 0.8)
    there = wedge_spectrum(edges, source, mic, FREQUENCIES_HZ)
    np.testing.assert_allclose(wedge_spectrum(edges, mic, source, FREQUENCIES_HZ), there, rtol=1e-9)


def test_level_follows_asymptotic_distance_laws():
    """Deep in the shadow of a long edge: with 1 / sqrt(r_s r_r (r_s + r_r)) (Keller); a short edge: 1 / (r_s r_r)."""
    frequency_hz, source_deg, mic_deg = [1000.0], 40.0, 320.0

    def level(edges, factor):
        return abs(wedge_spectrum(edges, at(2.0 * factor, source_deg), at(3.0 * factor, mic_deg), frequency_hz)[0])

    assert level(wedge(360.0), 4.0) / level(wedge(360.0), 1.0) == pytest.approx(4.0 ** -1.5, rel=0.01)
    assert level(wedge(360.0, 0.05), 4.0) / level(wedge(360.0, 0.05), 1.0) == pytest.approx(4.0 ** -2, rel=0.01)


def test_splitting_an_edge_preserves_its_spectrum():
    edges, source, mic = wedge(270.0, 3.0), at(1.2, 40.0, -0.3), at(2.9, 250.0, 0.8)
    whole = diffracted(edges, np.zeros(1), np.array([3.0]), source, mic)
    cuts = np.array([0.0, 0.4, 1.5, 1.6, 3.0])
    parts = diffracted(edges, cuts[:-1], cuts[1:], source, mic)
    spectrum = [np.abs(np.fft.rfft(one.signals.sum(axis=0), 4096))[:1536] for one in (whole, parts)]
    np.testing.assert_allclose(20.0 * np.log10(spectrum[1] / spectrum[0]), 0.0, atol=0.1)


def lifted_box_obj(size_m, corner_m, first_vertex, material="wood"):
    lines = []
    for line in prism_obj(box_plan(size_m[0], size_m[1], *corner_m[:2]), size_m[2], material).splitlines():
        words = line.split()
        if words[0] == "v":
            words[3] = str(float(words[3]) + corner_m[2])
        elif words[0] == "f":
            words[1:] = [str(int(word) + first_vertex) for word in words[1:]]
        lines.append(" ".join(words))
    return "\n".join(lines) + "\n"


@pytest.fixture
def room_with_box(tmp_path):
    """6 x 4 x 3 m with a cupboard of 1 x 1 x 1.5 m in the air, from (2.5, 1.5, 0.5) on."""
    path = tmp_path / "room.obj"
    path.write_text(prism_obj(box_plan(6.0, 4.0), 3.0) + lifted_box_obj((1.0, 1.0, 1.5), (2.5, 1.5, 0.5), 8))
    return load_mesh(path)


def test_only_convex_edges_diffract(room_with_box, tmp_path):
    edges = find_edges(room_with_box)
    assert len(edges) == 12 and edges.n_left_out == 0
    np.testing.assert_allclose(np.degrees(edges.wedge_rad), 270.0)
    np.testing.assert_allclose(np.sort(edges.length_m), [1.0] * 8 + [1.5] * 4)
    path = tmp_path / "l.obj"
    path.write_text(prism_obj(L_PLAN, 3.0))
    corner = find_edges(load_mesh(path))
    assert len(corner) == 1 and corner.length_m[0] == pytest.approx(3.0)
    np.testing.assert_allclose(np.sort([corner.start_m[0, 2], corner.start_m[0, 2] + 3.0 * corner.along[0, 2]]), [0, 3])
    np.testing.assert_allclose(corner.start_m[0, :2], 2.0)


def test_convex_rooms_have_no_diffraction(tmp_path):
    path = tmp_path / "box.obj"
    path.write_text(prism_obj(box_plan(6.0, 4.0), 3.0))
    for room in (Shoebox((6.0, 4.0, 3.0)), load_mesh(path)):
        assert find_edges(room) is None
        assert diffract(room, (1, 1, 1), (4, 3, 1), speed_m_s=C, n_samples=800, direct_visible=True) is None
        scene = Scene(room, [Material("all", 0.2, 0.1)] * len(room.surfaces))
        with_, without = (simulate_responses(scene, (1, 1, 1), (4, 3, 1), num_rays=500, diffraction=which)[0]
                          for which in (True, False))
        np.testing.assert_array_equal(with_.rir, without.rir)
        assert not with_.diffracted


def test_collinear_segments_merge_into_one_edge(room_with_box):
    """Every triangle in four: the edges stay what they were."""
    a, b, c = room_with_box.triangles.transpose(1, 0, 2)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    fine = np.concatenate([np.stack(three, axis=1) for three in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    names = list(np.array(room_with_box.surfaces)[np.tile(room_with_box.face_surface, 4)])
    edges = find_edges(make_room(fine, names))
    assert len(edges) == 12
    np.testing.assert_allclose(np.sort(edges.length_m), [1.0] * 8 + [1.5] * 4)


@pytest.mark.parametrize("between", [[(5.0, 0.0)], [(3.0, 0.0), (5.0, 0.0), (7.0, 0.0)]])
def test_corners_in_the_middle_of_a_wall_change_no_edge(between, tmp_path):
    """Floor and ceiling then have triangles without an area, which are left out."""
    (tmp_path / "l.obj").write_text(prism_obj([(0, 0), *between, (10, 0), (10, 3), (4, 3), (4, 8), (0, 8)], 3.0))
    edges = find_edges(load_mesh(tmp_path / "l.obj"))
    assert len(edges) == 1 and np.degrees(edges.wedge_rad) == pytest.approx(270.0)
    assert edges.length_m == pytest.approx(3.0) and edges.start_m[0, :2] == pytest.approx([4.0, 3.0])


def test_corners_in_the_middle_of_an_edge_change_no_edge(room_with_box):
    """A triangle of a cupboard's top is cut in two where the triangle at its side is not, with a sliver between."""
    triangles = room_with_box.triangles
    top = next(n for n, triangle in enumerate(triangles) if np.allclose(triangle[:, 2], 2.0))
    a, b, c = triangles[top]
    middle = 0.4 * a + 0.6 * b
    cut = np.concatenate([np.delete(triangles, top, axis=0), [(a, middle, c), (middle, b, c), (a, b, middle)]])
    edges = find_edges(make_room(cut, ["all"] * len(cut)))
    np.testing.assert_allclose(np.degrees(edges.wedge_rad), 270.0)
    np.testing.assert_allclose(np.sort(edges.length_m), [1.0] * 8 + [1.5] * 4)


def test_excess_edges_are_dropped_with_a_warning(room_with_box, monkeypatch, caplog):
    monkeypatch.setattr("roomeq.sim.diffraction.MAX_EDGES", 4)
    edges = find_edges(make_room(room_with_box.triangles, ["all"] * len(room_with_box.triangles)))
    assert len(edges) == 4 and edges.n_left_out == 8 and np.all(edges.length_m > 1.4)
    assert "12 edges that diffract: the 4 longest do" in caplog.text


def test_early_level_is_continuous_at_shadow_in_room(room_with_box):
    """Move a microphone out of the shadow of the cupboard: the early sound has no jump, without diffraction it has."""
    source = (1.0, 2.0, 1.0)  # rays past (3.5, 2.5) and (2.5, 2.5): the near edge is the silhouette
    edge_y = 2.5 + (2.5 - 2.0) / (2.5 - 1.0) * 2.5  # y of the boundary at x = 5
    scene = Scene(room_with_box, [Material("black", 1.0, 0.0)] * len(room_with_box.surfaces))
    levels = {}
    for diffraction in (True, False):
        mics = [(5.0, edge_y + shift, 1.0) for shift in (-0.002, 0.002)]
        found = simulate_responses(scene, source, mics, num_rays=500, ism_order=0, diffraction=diffraction)
        assert [one.direct_visible for one in found] == [False, True]
        window = slice(int(found[0].direct_sample) - 40, int(found[0].direct_sample) + 20)
        spectra = [np.abs(np.fft.rfft(one.rir[window], 512))[16:192] for one in found]
        levels[diffraction] = 20.0 * np.log10(spectra[1] / np.maximum(spectra[0], 1e-12))
    np.testing.assert_allclose(levels[True], 0.0, atol=0.5)
    assert levels[False].min() > 20.0


def test_no_sound_runs_below_furniture_on_the_floor(tmp_path):
    """How deep a body stands in the floor, or how close above it, does not matter."""
    spectra = []
    for depth_m in (0.0, 0.1, 0.3, -0.001, -0.01):
        path = tmp_path / f"{depth_m}.obj"
        body = lifted_box_obj((2.0, 1.0, 1.5 + depth_m), (2.0, 2.0, -depth_m), 8)
        path.write_text(prism_obj(box_plan(8.0, 6.0), 3.0) + body)
        spectra.append(np.abs(shadow_spectrum(load_mesh(path), (1.0, 2.5, 0.7), (5.5, 2.6, 0.9))))
    levels = 20.0 * np.log10(spectra / spectra[0])[:, SHADOW_HZ != 1000.0]  # there is a notch
    np.testing.assert_allclose(levels, 0.0, atol=0.4)


def test_absorbing_faces_keep_only_the_shadow_terms(room_with_box):
    how = dict(speed_m_s=C, n_samples=1600, direct_visible=True)
    found = diffract(room_with_box, (1.0, 2.3, 1.0), (3.0, 3.5, 1.0), **how)
    wood = 1 + room_with_box.surfaces.index("wood")
    rows = [n for n, row in enumerate(found.signals) if np.any(row)]
    assert rows[0] == 0 and wood in rows and 1 + room_with_box.surfaces.index("wall") not in rows
    absorption = np.full((len(room_with_box.surfaces), 8), 1.0)
    scene = Scene(room_with_box, [Material("smooth", 1.0, 0.0)] * len(absorption))
    rir = found.response(absorption, scene, 1600)
    black = found.first_sample + np.argmax(np.abs(found.signals[0]))
    assert rir[black] == pytest.approx(found.signals[0][black - found.first_sample], rel=0.1)


def turned_away(place_m, turned_deg):
    """A cardioid that is turned away from the origin about z."""
    angle = np.arctan2(-place_m[1], -place_m[0]) + np.radians(turned_deg)
    return lambda ways: 0.5 + 0.5 * (ways @ np.array([np.cos(angle), np.sin(angle), 0.0]))


@pytest.mark.parametrize("turned_deg", [0.0, 60.0, 120.0])
def test_directive_source_and_microphone_act_on_diffracted_sound(turned_deg):
    """Against the edge in pieces of 2 cm, each with the gain of its own direction."""
    edges, source, mic = wedge(270.0, 3.0), at(1.2, 40.0, -0.3), at(1.9, 250.0, 0.6)
    directive = [turned_away(end, turned_deg) for end in (source, mic)]
    ends_m = np.linspace(0.0, 3.0, 151)
    exact = np.zeros(4096)
    for low_m, high_m in zip(ends_m[:-1], ends_m[1:], strict=True):
        piece = diffracted(edges, np.array([low_m]), np.array([high_m]), source, mic)
        middle = edges.start_m[0] + 0.5 * (low_m + high_m) * edges.along[0]
        gains = [gain((middle - end)[None] / np.linalg.norm(middle - end))[0]
                 for gain, end in zip(directive, (source, mic), strict=True)]
        signal = piece.signals.sum(axis=0)
        exact[piece.first_sample:piece.first_sample + len(signal)] += gains[0] * gains[1] * signal
    found = diffracted(edges, np.zeros(1), edges.length_m, source, mic, directions=True)
    rendered = np.zeros(4096)
    rendered[found.first_sample:found.first_sample + found.signals.shape[1]] = (
        found.signals.sum(axis=0) * directive[0](found.departure) * directive[1](found.arrival))
    spectrum = [np.abs(np.fft.rfft(signal))[16:1800] for signal in (exact, rendered)]
    np.testing.assert_allclose(20.0 * np.log10(spectrum[1] / spectrum[0]), 0.0, atol=1.0)


def test_talker_radiates_less_over_edges_behind_it(room_with_box):
    scene = Scene(room_with_box, [Material("all", 0.99, 0.0)] * len(room_with_box.surfaces))

    def octaves_db(facing):
        on, off = (simulate_responses(scene, (1.0, 2.0, 1.0), (5.0, 2.6, 1.2), num_rays=500, ism_order=0,
                                      source_directivity=facing, diffraction=which)[0].rir for which in (True, False))
        return power_db(octave_energies(on - np.pad(off, (0, max(0, len(on) - len(off))))[:len(on)]))

    forwards, backwards = (partial(Loudspeaker(facing, 0.1, 0.04).pressure, fs_hz=FS_HZ)
                           for facing in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    omni, towards, away = map(octaves_db, (None, forwards, backwards))
    angle = np.radians(np.arange(10.0, 36.0))  # at which the source sees the edges
    ways = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
    for rendered, gain in ((towards, forwards), (away, backwards)):
        gain_db = power_db(gain(ways) ** 2)
        assert np.all(rendered - omni > gain_db.min(axis=0) - 1.0)
        assert np.all(rendered - omni < gain_db.max(axis=0) + 1.0)
    assert away[-1] < omni[-1] - 6.0


def test_diffraction_switch_changes_the_response(room_with_box):
    scene = Scene(room_with_box, [Material("all", 0.3, 0.1)] * len(room_with_box.surfaces))
    source, mic = (1.0, 2.0, 1.0), (5.0, 2.6, 1.2)
    on, off = (simulate_responses(scene, source, mic, num_rays=500, diffraction=which)[0] for which in (True, False))
    assert on.diffracted and not off.diffracted and not on.direct_visible
    way_m = min(np.linalg.norm(np.subtract(place, source)) + np.linalg.norm(np.subtract(place, mic))
                for place in ((2.5, 2.5, 1.1), (3.5, 2.5, 1.15)))
    first = int(way_m / C * FS_HZ)
    extra = on.rir - off.rir
    assert np.abs(extra[:first - 60]).max() < 0.02 * np.abs(extra).max()
    assert np.abs(extra[first - 5:first + 60]).max() == np.abs(extra).max()


SHADOW_HZ = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0])


def shadow_spectrum(room, source, mic, until_sample=None):
    """Diffraction in a room with rigid surfaces, faded out before a sample."""
    found = diffract(room, source, mic, speed_m_s=C, n_samples=4000, direct_visible=False)
    sample = found.first_sample + np.arange(found.signals.shape[1])
    fade = np.ones(len(sample))
    if until_sample is not None:
        fade = np.sin(0.5 * np.pi * np.clip((until_sample - sample) / 150.0, 0.0, 1.0)) ** 2
    return np.exp(-2j * np.pi * np.outer(SHADOW_HZ / FS_HZ, sample)) @ (found.signals.sum(axis=0) * fade)


def test_second_order_diffraction_is_continuous_and_reciprocal(room_with_box):
    """No edge is seen from both sides. Into the plane of a face, and out of it, both orders make a continuous field."""
    source, mic = np.array([1.0, 2.0, 1.0]), np.array([5.0, 2.1, 1.2])
    edges = find_edges(room_with_box)
    inside = [edges.coordinates(one)[1] <= edges.wedge_rad for one in (source, mic)]
    assert not np.any(inside[0] & inside[1] & (edges.length_m > 1.4))  # of the upright edges, none
    there = shadow_spectrum(room_with_box, source, mic)
    assert np.all(np.abs(there) > 1e-3 / (4.0 * np.pi * 4.0))
    np.testing.assert_allclose(np.abs(shadow_spectrum(room_with_box, mic, source)), np.abs(there), rtol=0.02)
    for moved in ("source", "mic"):
        levels = []
        for y in (2.49, 2.51):
            ends = dict(source=source, mic=mic) | {moved: np.array([1.0 if moved == "source" else 5.0, y, 1.0])}
            levels.append(20.0 * np.log10(np.abs(shadow_spectrum(room_with_box, **ends))))
        np.testing.assert_allclose(levels[0], levels[1], atol=2.5)


@pytest.mark.parametrize("y", [1.5, 2.5])
@pytest.mark.parametrize("moved", [0, 1], ids=["source", "mic"])
def test_sound_in_the_plane_of_a_face_does_not_depend_on_rounding(room_with_box, moved, y):
    """Whether a face lights a point or not, both orders have to agree on it."""
    levels = []
    for off_m in (-1e-4, -1e-11, -1e-13, -1e-15, 0.0, 1e-15, 1e-13, 1e-11, 1e-4):
        ends = np.array([[1.0, 2.0, 1.0], [5.0, 2.1, 1.2]])
        ends[moved, 1] = y + off_m
        levels.append(20.0 * np.log10(np.abs(shadow_spectrum(room_with_box, *ends))))
    lowest, highest = np.minimum(levels[0], levels[-1]), np.maximum(levels[0], levels[-1])
    assert np.all(levels > lowest - 0.1) and np.all(levels < highest + 0.1)


def barrier_integral(thickness_m, below_m, length_m):
    """The integral over both upper edges of a barrier (1999, sec. III) on a grid that is fine at the peaks of beta."""
    nu, to_edge_m = 2.0 / 3.0, np.hypot(3.0 - 0.5 * thickness_m, below_m)
    halves = [0.5 * nu * (np.pi + sign * (np.arctan2(3.0 - 0.5 * thickness_m, below_m) - 1.5 * np.pi))
              for sign in (1.0, -1.0)]

    def beta(eta):
        return 2.0 * sum(np.sin(2.0 * half) / (np.cosh(nu * eta) - np.cos(2.0 * half)) for half in halves)

    second = (np.arange(600) + 0.5) / 600.0 * length_m - 0.5 * length_m
    steps = np.sinh(np.linspace(-12.0, 12.0, 1201)) * 1e-4
    first, width = second[:, None] + 0.5 * (steps[1:] + steps[:-1]), np.diff(steps)
    between, m, n = (np.hypot(*pair) for pair in ((thickness_m, first - second[:, None]), (to_edge_m, first),
                                                  (to_edge_m, second[:, None])))
    eta_1 = np.arcsinh(first / to_edge_m) + np.arcsinh((first - second[:, None]) / thickness_m)
    eta_2 = np.arcsinh(second[:, None] / to_edge_m) + np.arcsinh((second[:, None] - first) / thickness_m)
    share = nu ** 2 / (2.0 * (4.0 * np.pi) ** 3) * beta(eta_1) * beta(eta_2) / (m * between * n) * width
    share *= (np.abs(first) < 0.5 * length_m) * length_m / 600.0
    return np.array([np.sum(share * np.exp(-2j * np.pi * f_hz / C * (m + between + n))) for f_hz in SHADOW_HZ])


@pytest.mark.parametrize("below_m", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("thickness_m", [0.002, 0.04, 0.3])
def test_second_order_matches_its_integral_close_to_the_shadow_boundary(tmp_path, thickness_m, below_m):
    """There both betas are steep along the same line of the two edges, the more so the closer the edges are."""
    path = tmp_path / "barrier.obj"
    path.write_text(prism_obj(box_plan(12.0, 1.5), 9.0)
                    + lifted_box_obj((thickness_m, 1.5, 4.0), (6.0 - 0.5 * thickness_m, 0.0, 0.0), 8))
    height_m = 4.0 - below_m
    found = shadow_spectrum(load_mesh(path), np.array([3.0, 0.75, height_m]), np.array([9.0, 0.75, height_m]))
    np.testing.assert_allclose(20.0 * np.log10(np.abs(found / barrier_integral(thickness_m, below_m, 1.5))), 0.0,
                               atol=0.4)


def around_cylinder_db(radius_m, source, mic, frequencies_hz):
    """Level beside a rigid upright cylinder at the origin relative to the free field, of a line source (2-D)."""
    k, n = 2.0 * np.pi * np.asarray(frequencies_hz)[:, None] / C, np.arange(60)
    source_m, mic_m = np.hypot(*source[:2]), np.hypot(*mic[:2])
    between_rad = np.arctan2(mic[1], mic[0]) - np.arctan2(source[1], source[0])
    of_order = np.where(n == 0, 1.0, 2.0) * np.cos(n * between_rad) * jvp(n, k * radius_m) / h1vp(
        n, k * radius_m) * hankel1(n, k * source_m) * hankel1(n, k * mic_m)
    free = hankel1(0, k[:, 0] * np.hypot(*(source - mic)[:2]))
    return 20.0 * np.log10(np.abs(1.0 - np.nansum(of_order, axis=1) / free))


@pytest.mark.parametrize("sections, within_db", [(4, 2.5), (8, 2.5), (10, 2.5), (12, 4.5), (16, 6.0), (24, 9.0)])
def test_sound_comes_around_columns_of_any_number_of_sides(sections, within_db):
    """Sound that diffracts more than twice is missing: of many sides, levels behind are too high at low frequencies."""
    walls, column = trimesh.creation.box((8.0, 6.0, 6.0)), trimesh.creation.cylinder(0.3, 5.94, sections)
    column.apply_transform(trimesh.transformations.rotation_matrix(np.pi / sections, (0.0, 0.0, 1.0)))
    room = make_room(np.concatenate([walls.triangles, column.triangles]), ["wall"] * 12 + ["wood"] * len(column.faces))
    source, mic = np.array([-2.0, 0.0, 0.0]), np.array([1.5, 0.1, 0.05])
    found = diffract(room, source, mic, speed_m_s=C, n_samples=2000, direct_visible=False)
    signal = found.signals.sum(axis=0)[:90]  # before what comes over the ends of the column
    for octave_hz in (250.0, 1000.0, 4000.0):
        frequencies_hz = octave_hz * 2.0 ** np.linspace(-0.5, 0.5, 15)
        pressure = np.exp(-2j * np.pi / FS_HZ * np.outer(frequencies_hz, np.arange(len(signal)))) @ signal
        free_m = 4.0 * np.pi * np.linalg.norm(source - mic)
        exact = 10.0 ** (0.1 * around_cylinder_db(0.3, source, mic, frequencies_hz))
        assert 10.0 * np.log10(np.mean(np.abs(free_m * pressure) ** 2) / np.mean(exact)) == pytest.approx(
            0.0, abs=within_db)


def test_thin_screen_matches_half_plane(tmp_path):
    """First and second order at a screen of 1 cm, whose other edges are far: what they leave out is below 2 dB."""
    path = tmp_path / "screen.obj"
    path.write_text(prism_obj(box_plan(20.0, 20.0), 8.0) + lifted_box_obj((0.01, 9.5, 7.0), (9.995, 0.25, 0.5), 8))
    source, mic = np.array([8.0, 8.75, 4.0]), np.array([12.5, 8.75, 4.0])  # the edge is x = 10, y = 9.75
    way_m = np.hypot(2.0, 1.0) + np.hypot(2.5, 1.0)
    found = shadow_spectrum(load_mesh(path), source, mic, until_sample=int(way_m / C * FS_HZ) + 170)
    turned = [np.array([9.75 - one[1], one[0] - 10.0, one[2] - 4.0]) for one in (source, mic)]
    exact = halfplane.exact(*turned, SHADOW_HZ, C)
    np.testing.assert_allclose(20.0 * np.log10(np.abs(found / exact)), 0.0, atol=2.0)
