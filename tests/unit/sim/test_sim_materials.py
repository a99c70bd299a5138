"""Materials by name: own tables, the published one, meshes whose materials are named, unknown names."""

import json

import numpy as np
import pytest
from plans import box_plan, prism_obj

from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_jsonl
from roomeq.records.rir_dir import read_rirs
from roomeq.sim import published
from roomeq.sim.materials import draw_scattering, find_surface, given_surfaces, named_scene, read_materials
from roomeq.sim.mesh import load_mesh
from roomeq.sim.meshfile import read_triangles
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Shoebox
from roomeq.simulate_rirs import simulate

PUBLISHED = {"center_freqs": [125, 250, 500, 1000, 2000, 4000, 8000],
             "absorption": {"Wood": {"oak_panel": {"description": "", "coeffs": [.1, .2, .3, .4, .5, .6]},
                                     "pine_panel": {"description": "", "coeffs": [.7, .6, .5, .4, .3, .2, .1]}}},
             "scattering": {"Seating": {"stalls": {"description": "", "coeffs": [.1, .2, .3, .4, .5]}}}}


@pytest.fixture
def published_table(tmp_path, monkeypatch):
    """Stand in for the table of an installed pyroomacoustics."""
    path = tmp_path / "published.json"
    path.write_text(json.dumps(PUBLISHED))
    monkeypatch.setattr(published, "published_file", lambda: path)
    monkeypatch.setattr("roomeq.sim.materials.published_file", lambda: path)
    published.read_published.cache_clear()
    yield path
    published.read_published.cache_clear()


@pytest.fixture
def nothing_published(monkeypatch):
    monkeypatch.setattr(published, "published_file", lambda: None)
    monkeypatch.setattr("roomeq.sim.materials.published_file", lambda: None)
    published.read_published.cache_clear()
    yield
    published.read_published.cache_clear()


@pytest.mark.parametrize("given, extended", [
    ([1, 2, 3, 4, 5], (1, 1, 2, 3, 4, 5, 5, 5)),
    ([1, 2, 3, 4, 5, 6], (1, 1, 2, 3, 4, 5, 6, 6)),
    ([1, 2, 3, 4, 5, 6, 7], (1, 1, 2, 3, 4, 5, 6, 7)),
    ([1, 2, 3, 4, 5, 6, 7, 8], (1, 2, 3, 4, 5, 6, 7, 8)),
])
def test_missing_bands_take_neighbouring_values(given, extended):
    assert published.extend_bands(given) == extended


def test_published_materials_are_found_by_name(published_table):
    table = read_materials()
    wood = find_surface(table, "oak_panel")
    assert wood.absorption == (.1, .1, .2, .3, .4, .5, .6, .6) and wood.scattering is None
    seats = find_surface(table, {"absorption": "pine_panel", "scattering": "stalls"})
    assert seats.name == "pine_panel" and seats.scattering == (.1, .1, .2, .3, .4, .5, .5, .5)
    own = find_surface(table, {"absorption": [0.5] * 8, "scattering": "rough"})
    assert own.absorption == (0.5,) * 8 and own.scattering == table.scattering["rough"]
    with pytest.raises(ValueError, match=r"absorption='oak_pannel' is in no table of materials \(closest: oak_panel"):
        find_surface(table, "oak_pannel")
    with pytest.raises(ValueError, match=r"scattering='stall' is in no table of materials \(closest: stalls"):
        find_surface(table, {"absorption": "oak_panel", "scattering": "stall"})


def test_unknown_name_error_states_missing_package(nothing_published):
    with pytest.raises(ValueError, match=r"absorption='carpet_thn' .*closest: carpet_thin.*pyroomacoustics, whose"):
        find_surface(read_materials(), "carpet_thn")


def test_published_table_of_other_format_is_rejected(published_table):
    published_table.write_text('{"absorption": {"Wood": {"oak": {"coeffs": [0.1, 0.2]}}}, "scattering": {}}')
    with pytest.raises(ValueError, match=r"published.json: cannot be read as pyroomacoustics' table .*2 coefficients"):
        find_surface(read_materials(), "no_such_thing")


def test_installed_published_table_is_read():
    pytest.importorskip("pyroomacoustics")
    published.read_published.cache_clear()
    table = published.read_published()
    assert len(table["absorption"]) > 50 and table["scattering"]
    assert all(len(bands) == 8 for what in table.values() for bands in what.values())


def test_user_table_may_have_fewer_bands_and_scattering(tmp_path, caplog):
    path = tmp_path / "own.toml"
    path.write_text("[scattering]\ncoarse = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]\n"
                    "[materials.felt]\nabsorption = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\nscattering = 'coarse'\n"
                    "[materials.foam]\nabsorption = 0.9\nscattering = 0.3\n")
    with caplog.at_level("INFO"):
        table = read_materials(path)
    assert table.absorption["felt"] == (.1, .1, .2, .3, .4, .5, .6, .6)
    assert find_surface(table, "felt").scattering == (.1, .1, .2, .3, .4, .5, .6, .7)
    assert find_surface(table, "foam").scattering == (0.3,) * 8
    assert "own.toml: coarse, felt: fewer than 8 bands; 62.5 Hz takes the value at 125 Hz" in caplog.text
    assert "own.toml: felt, foam: their scattering counts where a row or room type names the material" in caplog.text
    path.write_text("[materials.felt]\nabsorption = [0.1, 0.2, 0.3]\n")
    with pytest.raises(ValueError, match=r"own.toml: absorption of material 'felt': 3 coefficients must be 9"):
        read_materials(path)
    path.write_text("[scattering]\nrough = 0.3\n[materials.felt]\nabsorption = 0.1\nscattering = 'ruff'\n")
    with pytest.raises(ValueError, match=r"own.toml: scattering='ruff' is in no table .*closest: rough"):
        read_materials(path)


def test_stated_materials_are_assigned_to_surfaces(published_table):
    table, room = read_materials(), Shoebox((5.0, 4.0, 3.0))
    given = given_surfaces(table, room, {"floor": "carpet_thin", "default": "oak_panel"})
    assert [given[surface].name for surface in room.surfaces] == ["oak_panel"] * 4 + ["carpet_thin", "oak_panel"]
    assert given_surfaces(table, room, None) == {}
    rough = given_surfaces(table, room, {"north": {"absorption": "oak_panel", "scattering": 0.7}})
    drawn, kept = (draw_scattering(table, room, np.random.default_rng(0), which) for which in ({}, rough))
    assert np.all(kept[3] == 0.7)
    np.testing.assert_array_equal(np.delete(kept, 3, axis=0), np.delete(drawn, 3, axis=0))
    with pytest.raises(ValueError, match=r"materials: 'flor' must be one of the room's \(west, .*'default'"):
        given_surfaces(table, room, {"flor": "carpet_thin"})
    with pytest.raises(ValueError, match=r"nothing is given for west, east, south, north, ceiling"):
        named_scene(room, {"floor": "carpet_thin"})
    with pytest.raises(ValueError, match="materials='carpet_thin' must be a mapping .*: give {'default': ...} for all"):
        named_scene(room, "carpet_thin")
    with pytest.raises(ValueError, match=r"material 3 must be a name or an object"):
        given_surfaces(table, room, {"floor": 3})


def test_docstring_example_runs(tmp_path, published_table):
    path = tmp_path / "office.obj"
    path.write_text(prism_obj(box_plan(5.0, 4.0), 3.0, "brick wall").replace("usemtl floor", "usemtl oak"))
    room = load_mesh(path)
    assert room.surfaces == ("brick wall", "ceiling", "oak")
    scene = named_scene(room, {"oak": {"absorption": "oak_panel", "scattering": "rough"}, "default": "brick_plastered"})
    assert [one.name for one in scene.materials] == ["brick_plastered", "brick_plastered", "oak_panel"]
    (response,) = simulate_responses(scene, (1.0, 2.0, 1.2), (4.0, 3.0, 1.2), num_rays=500, seed=0)
    assert response.direct_visible and np.all(np.isfinite(response.rir))
    np.testing.assert_allclose(response.absorption, scene.absorption)


@pytest.mark.parametrize("solids", [["a", "b"], ["b 1", "a", "a", "b 1"], ["a_1", "a", "a"]])
def test_stl_solids_become_materials(solids, tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 {0}\nvertex 1 0 {0}\nvertex 0 1 {0}\nendloop\nendfacet\n"
    path = tmp_path / "two.stl"
    path.write_text("".join(f"solid {name}\n{facet.format(n)}endsolid {name}\n" for n, name in enumerate(solids)))
    triangles, names = read_triangles(path)
    assert [names[n] for n in np.argsort(triangles[:, 0, 2])] == solids


@pytest.fixture
def measured(tmp_path):
    """Rows of one mesh: materials kept as they are, scaled to a target of the row, and drawn."""
    directory = tmp_path / "measured"
    directory.mkdir()
    (directory / "room.obj").write_text(prism_obj(box_plan(5.0, 4.0), 3.0, "brick"))
    common = dict(room_id="r", source_id="s", fs_hz=FS_HZ, n_samples=FS_HZ, mesh="room.obj", mic_id="m",
                  source_pos_m=[1.0, 2.0, 1.5], mic_pos_m=[4.0, 3.0, 1.2])
    names = {"floor": "carpet_on_felt", "brick": {"absorption": [0.2] * 8, "scattering": 0.4},
             "default": "mineral_fibre_ceiling"}
    write_jsonl(directory / "rirs.jsonl", [
        common | dict(id="drawn", wav="a.wav"),
        common | dict(id="kept", wav="b.wav", materials=names, target_t60_s=None),
        common | dict(id="scaled", wav="c.wav", materials=names, target_t60_s=0.5),
        common | dict(id="target", wav="d.wav", target_t60_s=0.9)])
    return directory


def test_row_materials_are_used_in_simulation(measured, tmp_path):
    simulate(measured, tmp_path / "sim", num_rays=1000, noise_rirs=1, t60_range_s=(0.3, 0.6))
    rows = {row["id"]: row for row in read_rirs(tmp_path / "sim")}
    kept, scaled, table = rows["kept"], rows["scaled"], read_materials()
    assert kept["target_t60_s"] is None and kept["t30_s"] > 0.1
    assert kept["materials"]["brick"] == dict(material="own", absorption=[0.2] * 8, scattering=[0.4] * 8)
    assert kept["materials"]["floor"]["absorption"] == list(table.absorption["carpet_on_felt"])
    assert kept["materials"]["ceiling"]["material"] == "mineral_fibre_ceiling"
    assert rows["kept-noise1"]["materials"] == kept["materials"]
    assert scaled["t30_s"] == pytest.approx(0.5, rel=0.05)
    assert scaled["materials"]["floor"]["material"] == "carpet_on_felt"
    assert scaled["materials"]["floor"]["absorption"] != kept["materials"]["floor"]["absorption"]
    assert 0.3 <= rows["drawn"]["target_t60_s"] <= 0.6
    assert rows["target"]["target_t60_s"] == 0.9 and rows["target"]["t30_s"] == pytest.approx(0.9, rel=0.05)


def test_unknown_row_material_is_rejected(measured, tmp_path, nothing_published):
    rows = read_rirs(measured)
    write_jsonl(measured / "rirs.jsonl", [rows[1] | dict(materials={"default": "glas_window"})])
    with pytest.raises(ValueError, match=r"RIR kept: absorption='glas_window' .*closest: glass_window"):
        simulate(measured, tmp_path / "sim", num_rays=1000)
    write_jsonl(measured / "rirs.jsonl", [rows[1] | dict(materials={"walls": "glass_window"})])
    with pytest.raises(ValueError, match=r"RIR kept: materials: 'walls' must be one of the room's \(brick, ceiling"):
        simulate(measured, tmp_path / "sim", num_rays=1000)
