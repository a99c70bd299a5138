"""The loop's tables of ray contributions against the simulator's echograms of the same rays."""

import numpy as np
import pytest
from plans import L_PLAN, prism_obj

from roomeq.loop.tables import ANGLES, FRAME_EDGES_S, OF_SPHERE, collect, frame_edges_s
from roomeq.sim.echogram import FRAME_S, compute_echograms
from roomeq.sim.mesh import load_mesh
from roomeq.sim.response import trace_source
from roomeq.sim.scene import Material, Scene, Shoebox

ABSORPTION, LENGTH_S = 0.1, 0.5
EDGES_S = FRAME_EDGES_S[[0, 10, 18, 28, 38, 43]]
"""Windows long enough for echograms, which count from the emission in whole milliseconds."""
SOURCE_M, MICS_M = (1.2, 1.1, 1.4), np.array([[4.6, 0.9, 1.2], [1.0, 3.4, 1.6]])


@pytest.fixture(params=["L-shaped mesh", "shoebox"])
def room(request, tmp_path):
    if request.param == "shoebox":
        return Shoebox((6.0, 4.0, 3.0))
    path = tmp_path / "l.obj"
    path.write_text(prism_obj(L_PLAN, 3.0))
    return load_mesh(path)


def test_energy_of_every_time_window_is_that_of_the_echogram(room):
    scene = Scene(room, [Material("all", ABSORPTION, 0.3)] * len(room.surfaces))
    traced = trace_source(scene, SOURCE_M, num_rays=20000, max_length_s=LENGTH_S, rng=np.random.default_rng(0))
    speed_m_s = scene.air.speed_m_s
    echograms = compute_echograms(traced.paths[0], room, scene.absorption, MICS_M, ism_order=-1,
                                  n_frames=int(LENGTH_S / FRAME_S), speed_m_s=speed_m_s).energy[:, :, 0]
    for (table, _), echogram in zip(collect(traced, MICS_M), echograms, strict=True):
        frames, reflections = table.entries.T
        # of a uniform absorption, every share of floor and ceiling leaves the same
        energy = table.counts.sum(axis=1) * (1.0 - ABSORPTION) ** reflections
        tabled = np.histogram(FRAME_EDGES_S[frames], EDGES_S - 1e-9, weights=energy)[0]
        edges = np.interp((EDGES_S + table.distance_m / speed_m_s) / FRAME_S, np.arange(len(echogram) + 1.0),
                          np.arange(len(echogram) + 1.0))
        whole = np.interp(edges, np.arange(len(echogram) + 1.0), np.append(0.0, np.cumsum(echogram)))
        assert 10.0 * np.log10(tabled / np.diff(whole)) == pytest.approx(np.zeros(len(tabled)), abs=0.1)


@pytest.mark.parametrize("length_s, last_s", [(0.5, 4.640), (3.0, 4.640), (6.0, 13.243)])
def test_frames_last_longer_where_rays_do(length_s, last_s):
    scene = Scene(Shoebox((6.0, 4.0, 3.0)), [Material("all", 0.01, 0.3)] * 6)
    traced = trace_source(scene, SOURCE_M, num_rays=1000, max_length_s=length_s, rng=np.random.default_rng(0))
    tables = [table for table, _ in collect(traced, MICS_M)]
    assert frame_edges_s(tables)[-1] == pytest.approx(last_s, abs=1e-3)
    assert FRAME_EDGES_S[max(table.entries[:, 0].max() for table in tables)] == pytest.approx(length_s, rel=0.1)


def test_share_of_all_directions_at_each_angle():
    angle = np.arccos(np.linspace(-1.0, 1.0, 200001))  # evenly distributed directions
    shares = [np.interp(angle, ANGLES, of_angle).mean() for of_angle in np.eye(len(ANGLES))]
    np.testing.assert_allclose(OF_SPHERE, shares, atol=1e-5)
