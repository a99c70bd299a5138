"""Data of the loop: places of sources, and devices that are the same."""

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from plans import L_PLAN, prism_obj
from rirmaker import coloured_rir, write_rir_dir

from roomeq.loop.data import SAME_PLACE_M, Data, _merge_sources, _Recording, _share_facings, _traced_length_s, load_data
from roomeq.loop.features import BAND_OF_FEATURE, METRIC
from roomeq.loop.predict import _eyring_times_s
from roomeq.loop.session import fit_base_model
from roomeq.loop.usable import usable_rirs
from roomeq.sim.geometry import Place
from roomeq.sim.scene import Air, Material, Scene, Shoebox, eyring_time_s


def test_merged_places_of_a_source_depend_on_no_order():
    room = Shoebox((6.0, 5.0, 3.0))
    at_m = {0.0: 2.0, 0.1: 2.1, 0.2: 2.2, 1.0: 3.0}
    found = set()
    for order in permutations(at_m):
        recordings = [_Recording(None, dict(room_id="r", source_id="s"),
                                 Place(room, (at_m[n], 1.0, 1.0), (5.0, 4.0, 1.0), ())) for n in order]
        merged = {n: recording.place.source_pos_m[0] for n, recording in zip(order, _merge_sources(recordings),
                                                                             strict=True)}
        assert all(abs(merged[n] - at_m[n]) <= SAME_PLACE_M / 2.0 for n in at_m)
        found.add(tuple(np.round([merged[n] for n in at_m], 9)))
    assert len(found) == 1


def test_source_is_not_moved_into_its_microphone():
    """The mean of two positions, 14 cm apart, is 1 cm from a microphone that is 6 cm from one of them."""
    room = Shoebox((6.0, 5.0, 3.0))
    recordings = [_Recording(None, dict(room_id="r", source_id="s"), Place(room, (x, 1.0, 1.0), mic_m, ()))
                  for x, mic_m in ((2.0, (2.06, 1.0, 1.0)), (2.0, (5.0, 4.0, 1.0)), (2.14, (5.0, 4.0, 1.0)))]
    merged = _merge_sources(recordings)
    assert [recording.place.source_pos_m[0] for recording in merged] == pytest.approx([2.0, 6.14 / 3.0, 6.14 / 3.0])


@pytest.mark.parametrize("stated, taken", [
    ([(0.0, 1.0, 0.0), (0.0, 1.0, 0.0)], [0.0, 1.0, 0.0]),  # one direction, whatever the microphone
    ([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], None),  # turned to each microphone
    ([(0.0, 1.0, 0.0)], [0.0, 1.0, 0.0]),  # not that of its microphone
    ([(1.0, 0.0, 0.0)], None)])  # may be either
def test_facing_that_others_of_a_position_state_is_taken(stated, taken):
    mics_m, directions = [(3.0, 1.0, 1.0), (1.0, 3.0, 1.0), (2.0, 2.5, 1.0)], [*stated, None, None][:3]
    room = Shoebox((4.0, 4.0, 3.0))
    recordings = [_Recording(None, dict(room_id="r", source_id="s", source_dir=facing and list(facing)),
                             Place(room, (1.0, 1.0, 1.0), mic_m, ()))
                  for facing, mic_m in zip(directions, mics_m, strict=True)]
    elsewhere = recordings[-1]._replace(place=Place(room, (1.5, 1.0, 1.0), mics_m[2], ()))
    *_, last, other = _share_facings([*recordings, elsewhere])
    assert last.row["source_dir"] == taken and other.row["source_dir"] is None


def test_devices_without_a_name_are_one_within_a_corpus():
    rows = [dict(source_id=source, corpus=corpus) for source, corpus in (
        ("unknown", "a"), ("unknown", "a"), ("unknown", "b"), ("genelec", "a"), ("genelec", "b"))]
    names, number = Data.units(SimpleNamespace(rows=rows), "source")
    assert names == ["genelec", "unknown of a", "unknown of b"]
    assert number.tolist() == [1, 1, 2, 0, 0]


def test_direct_sound_of_a_hidden_source_is_not_scored(tmp_path):
    """Tables of rays have no direct sound there: its level would be that of nothing."""
    (tmp_path / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    rows = [dict(id=name, wav=f"{name}.wav", room_id="l", source_id="s", mic_id="m", mesh="../l.obj",
                 source_pos_m=[5.0, 1.0, 1.5], mic_pos_m=mic_m) for name, mic_m in
            (("free", [1.5, 1.2, 1.3]), ("hidden", [1.0, 5.0, 1.3]))]
    where = write_rir_dir(tmp_path / "rirs", [(row, coloured_rir(n)) for n, row in enumerate(rows)])
    data = load_data(usable_rirs([where]), scattering=0.3, seed=0)
    shows_direct = np.isin(METRIC, ("direct", "drr"))
    assert [row["id"] for row in data.rows] == ["free", "hidden"]
    assert data.valid[0, shows_direct].any() and not data.valid[1, shows_direct].any()
    assert data.valid[1, METRIC == "c50"].any()


@pytest.mark.parametrize("decay_s, length_s", [(0.2, 0.4), (1.0, 1.3), (2.8, 3.0), (3.0, 3.0), (7.0, 7.0),
                                               (20.0, 13.1)])
def test_rays_are_traced_for_the_decay_with_a_margin_up_to_3_s(decay_s, length_s):
    assert _traced_length_s(decay_s) == pytest.approx(length_s)


def test_decay_times_of_long_decays_are_predicted(tmp_path):
    rows = [dict(id=f"{room}{n}", wav=f"{room}{n}.wav", room_id=room, source_id="s", mic_id="m", room_dims_m=dims_m,
                 source_pos_m=[2.0, 1.5, 1.5], mic_pos_m=[5.0 + n, 4.0, 1.3], source_dir=[1.0, 0.0, 0.0])
            for room, dims_m in (("a", [12.0, 9.0, 5.0]), ("b", [10.0, 11.0, 6.0]), ("c", [14.0, 8.0, 5.5]))
            for n in range(2)]
    rirs = [(row, coloured_rir(n, time_s=8.0, length_s=10.0)) for n, row in enumerate(rows)]
    data = load_data(usable_rirs([write_rir_dir(tmp_path / "rirs", rirs)]), scattering=0.3, seed=0)
    # air alone decays faster at high frequencies
    decays = np.isin(METRIC, ("t20", "t30")) & (BAND_OF_FEATURE < 6)
    errors = np.abs(fit_base_model(data, seed=0, nj=1).residual[:, decays])
    assert np.nanmean(errors) < 1.5


def test_decay_longer_than_any_trace_is_named(tmp_path, caplog):
    row = dict(id="a", wav="a.wav", room_id="dome", source_id="s", mic_id="m", room_dims_m=[12.0, 9.0, 5.0],
               source_pos_m=[2.0, 1.5, 1.5], mic_pos_m=[5.0, 4.0, 1.3], source_dir=[1.0, 0.0, 0.0])
    where = write_rir_dir(tmp_path / "rirs", [(row, coloured_rir(0, time_s=16.0, length_s=15.0))])
    data = load_data(usable_rirs([where]), scattering=0.3, seed=0)
    assert data.traced[0].bare.max_length_s == pytest.approx(13.1)
    assert "room dome decays for 1" in caplog.text and "13.1 s at most" in caplog.text


def test_predicted_decay_time_is_that_of_the_scene():
    scene = Scene(Shoebox((6.0, 5.0, 3.0)), (Material("m", (0.2,) * 8, (0.3,) * 8),) * 6, Air())
    surface_m2 = np.array([2.0 * 3.0 * (6.0 + 5.0), 2.0 * 6.0 * 5.0])
    data = SimpleNamespace(surface_per_m=surface_m2[None] / 90.0)
    state = SimpleNamespace(absorption=np.full((1, 2, 8), -np.log(0.8)), speed_m_s=np.array([scene.air.speed_m_s]),
                            air_per_m=scene.air.attenuation_per_m[None])
    np.testing.assert_allclose(_eyring_times_s(data, state)[0], eyring_time_s(scene), rtol=1e-9)
