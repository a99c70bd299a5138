"""The public calls for rooms, responses and directivities."""

import json
from functools import partial

import numpy as np
import pytest
from plans import L_PLAN, box_plan, prism_obj

import roomeq
from roomeq.core.constants import exact_bands_hz
from roomeq.sim.scene import Air

MIC_M, SOURCE_M = (4.0, 3.0, 1.2), (2.0, 1.5, 1.5)
DISTANCE_M = float(np.linalg.norm(np.subtract(MIC_M, SOURCE_M)))
ROOM = roomeq.Room((6.0, 4.0, 3.0), materials=0.3)
DIRECTIVITIES = [roomeq.FirstOrder("cardioid", (1.0, 0.5, 0.0)), roomeq.FirstOrder("figure_eight", (0.0, 1.0, 0.0)),
                 roomeq.FirstOrder("hypercardioid", (-1.0, 0.0, 0.2)), roomeq.Loudspeaker((1.0, 0.7, 0.0))]


def direct_sample(fs=16000):
    return DISTANCE_M / Air().speed_m_s * fs


def parameters(rir, fs=16000):
    return roomeq.analyse(rir, fs, direct=(direct_sample(fs), 1))


def test_response_begins_with_the_direct_sound_of_a_unit_pulse():
    for fs in (8000, 48000):
        rir = roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, fs, num_rays=500)
        first = round(direct_sample(fs))
        assert rir.ndim == 1 and not np.any(np.abs(rir[:first - 40]) > 1e-6)
        assert np.sum(rir[first - 2:first + 3]) == pytest.approx(1.0 / (4.0 * np.pi * DISTANCE_M), rel=0.1)


@pytest.mark.parametrize(("absorption", "warned"), [([0.05] * 5 + [0.9], True), ([0.3] * 6, False)])
def test_decay_of_few_rays_is_warned_of(absorption, warned, caplog):
    walls = dict(zip(("west", "east", "south", "north", "floor", "ceiling"), absorption, strict=True))
    roomeq.simulate_rir(roomeq.Room((8.0, 6.0, 3.0), materials=walls), SOURCE_M, MIC_M)
    assert ("few of 10000 rays tell the decay of an octave" in caplog.text) == warned


def test_coincident_pair_hears_different_reverberation():
    """Figure-eights at right angles have no coherence in a diffuse field; two omnidirectional ones are alike."""
    crossed = [roomeq.FirstOrder("figure_eight", axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    for directivities, low, high in ((crossed, -0.2, 0.2), (None, 0.99, 1.0)):
        rirs = roomeq.simulate_rir(roomeq.Room((6.0, 4.0, 3.0), materials=0.1), SOURCE_M, [MIC_M] * 2, num_rays=500,
                                   mic_directivity=directivities)
        assert low <= np.corrcoef(rirs[:, 4000:12000])[0, 1] <= high


@pytest.mark.parametrize("options, message", [
    (dict(arrays=[0]), r"arrays=\[0\] must be a list with one for each of 2 microphones"),
    (dict(arrays=[0, 0, 0]), "with one for each of 2 microphones"),
    (dict(mic_directivities=[None]), r"mic_directivities=\[None\] must be a list with one for each of 2"),
    (dict(mic_directivities=DIRECTIVITIES[0].pressure), "must be a list with one for each of 2"),
    (dict(mic_directivities=DIRECTIVITIES[:2]), "directivity=FirstOrder.* must be a function of directions"),
    (dict(source_directivity=DIRECTIVITIES[0]), "directivity=FirstOrder.* must be a function of directions")])
def test_arrays_and_directivities_that_fit_no_microphones_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        roomeq.simulate_responses(ROOM.scene(), SOURCE_M, [MIC_M, (4.1, 3.0, 1.2)], num_rays=100, **options)


def test_responses_take_arrays_and_functions_of_directions():
    mics_m = [MIC_M, (4.1, 3.0, 1.2)]
    rirs = roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, num_rays=500, source_directivity=DIRECTIVITIES[0])
    responses = roomeq.simulate_responses(ROOM.scene(), SOURCE_M, mics_m, num_rays=500, arrays=np.zeros(2),
                                          source_directivity=partial(DIRECTIVITIES[0].pressure, fs_hz=16000))
    for rir, response in zip(rirs, responses, strict=True):
        assert np.array_equal(rir[:len(response.rir)], response.rir)


class Odd:
    """A directivity whose gains have a shape of their own."""

    def __init__(self, gains):
        self.gains = gains

    def pressure(self, directions, fs_hz):
        return self.gains


@pytest.mark.parametrize("directivity, message", [
    (roomeq.FirstOrder, "must be a FirstOrder"), ("cardioid", "directivity='cardioid' must be a FirstOrder"),
    (Odd(np.ones(1)), r"shape \(1,\)"),
    (Odd(np.full((1, 8), 1j)), r"complex128 gains of shape \(1, 8\) .* must return finite real ones"),
    (Odd(np.full((1, 8), np.nan)), "must return finite"), (Odd(np.ones((1, 7))), r"of shape \(1, 8\), one for each")])
def test_odd_directivities_are_refused(directivity, message):
    with pytest.raises(ValueError, match=message):
        roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, mic_directivity=directivity, num_rays=100)


def test_directivities_may_come_in_an_array():
    both = [None, roomeq.FirstOrder("cardioid", (1.0, 0.0, 0.0))]
    mics_m = [MIC_M, (4.1, 3.0, 1.2)]
    found, wanted = (roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, mic_directivity=given, num_rays=100)
                     for given in (np.array(both, dtype=object), both))
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize("azimuth_deg, elevation_deg, largest_db", [(10, 10, 2.5), (2, 10, 2.5), (5, 30, 6.0)])
def test_table_is_interpolated_on_grids_that_are_finer_in_one_angle(azimuth_deg, elevation_deg, largest_db):
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 361, azimuth_deg)),
                                     np.radians(np.arange(-90, 91, elevation_deg)))
    grid = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)],
                    axis=-1).reshape(-1, 3)
    speaker = roomeq.Loudspeaker((1.0, 0.0, 0.0))
    bands_hz = exact_bands_hz(16000)
    table = roomeq.DirectivityTable(grid, bands_hz, 20.0 * np.log10(speaker.pressure(grid, 16000)), (1.0, 0.0, 0.0))
    asked = np.random.default_rng(0).standard_normal((2000, 3))
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    error_db = 20.0 * np.log10(table.pressure(asked, 16000) / speaker.pressure(asked, 16000))
    assert np.abs(error_db[:, :7]).max() < largest_db
    assert np.abs(table.pressure(grid, 16000) / speaker.pressure(grid, 16000) - 1.0).max() < 1e-6


def test_table_of_one_plane_has_gains_in_all_directions():
    angle = np.radians(np.arange(0, 360, 10))
    plane = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    table = roomeq.DirectivityTable(plane, [1000.0], np.zeros((36, 1)), (1.0, 0.0, 0.0))
    assert table.pressure(np.eye(3), 16000) == pytest.approx(np.ones((3, 8)))


def test_array_has_a_row_for_each_microphone_and_the_same_bytes_again():
    mics_m = [MIC_M, (4.1, 3.0, 1.2), (1.0, 1.0, 1.0)]
    rirs = roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, num_rays=500, seed=4)
    assert rirs.shape[0] == 3
    assert np.array_equal(rirs, roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, num_rays=500, seed=4))
    assert not np.array_equal(rirs, roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, num_rays=500, seed=5))


def test_late_reverberation_is_coherent_at_near_microphones_as_in_a_diffuse_field():
    distance_m = 0.1
    room = roomeq.Room((6.0, 4.0, 3.0), materials={"absorption": 0.05, "scattering": 0.9})
    spectra = []
    for seed in range(3):
        mics_m = [MIC_M, (MIC_M[0] + distance_m, *MIC_M[1:])]
        rirs = roomeq.simulate_rir(room, SOURCE_M, mics_m, num_rays=2000, seed=seed)
        frames = rirs[:, 3200:3200 + 256 * 60].reshape(2, 60, 256) * np.hanning(256)
        spectra.append(np.fft.rfft(frames))
    first, second = np.concatenate(spectra, axis=1)
    found = np.sum(first * second.conj(), axis=0).real / np.sqrt(
        np.sum(np.abs(first) ** 2, axis=0) * np.sum(np.abs(second) ** 2, axis=0))
    expected = np.sinc(2.0 * np.fft.rfftfreq(256, 1.0 / 16000) * distance_m / Air().speed_m_s)
    assert np.abs(found - expected)[2:-2].mean() < 0.1 and found[2] > 0.9


@pytest.mark.parametrize("rate", [np.uint16, np.float16, np.float32])
def test_sample_rates_of_numpy_act_like_those_of_python(rate):
    mics_m = [MIC_M, (4.1, 3.0, 1.2)]
    found, wanted = (roomeq.simulate_rir(ROOM, SOURCE_M, mics_m, kind(48000), num_rays=500) for kind in (rate, int))
    assert np.array_equal(found, wanted)
    parameters = json.dumps(roomeq.analyse(found[0], rate(48000)))
    assert parameters == json.dumps(roomeq.analyse(found[0], 48000))


@pytest.mark.parametrize("room", [
    lambda: roomeq.Room(np.array([6.0, 4.0, 3.0]), 0.1), lambda: roomeq.Room([6, 4, 3], {"default": np.full(8, 0.1)})])
def test_rooms_may_be_compared_and_hashed(room):
    assert room() == room() and {room(): 1}[room()] == 1 and room() != roomeq.Room((6, 4, 3), 0.2)


def test_room_does_not_change_with_what_it_was_given():
    dims_m, materials = [6.0, 4.0, 3.0], {"default": [0.1] * 8}
    room = roomeq.Room(dims_m, materials)
    dims_m[0], materials["default"][0] = 60.0, 0.9
    assert room == roomeq.Room((6, 4, 3), {"default": (0.1,) * 8})


def test_reverberation_time_is_met():
    room = roomeq.Room((6.0, 4.0, 3.0), t60_s=0.4)
    assert parameters(roomeq.simulate_rir(room, SOURCE_M, MIC_M))["t30_s"][4] == pytest.approx(0.4, rel=0.05)


def test_materials_may_be_names_numbers_or_of_single_surfaces():
    rooms = [roomeq.Room((6, 4, 3), materials=materials) for materials in
             ("brick_plastered", 0.2, [0.1] * 8, np.full(9, 0.3), {"absorption": 0.2, "scattering": 0.5},
              {"floor": "carpet_thin", "default": 0.2})]
    absorption = [room.scene().absorption for room in rooms]
    assert absorption[1] == pytest.approx(0.2) and absorption[3] == pytest.approx(0.3)
    assert absorption[4] == pytest.approx(0.2) and rooms[4].scene().scattering == pytest.approx(0.5)
    assert absorption[5][0] == pytest.approx(0.2) and not np.allclose(absorption[5][4], 0.2)


def test_material_of_all_surfaces_is_that_of_surfaces_named_like_a_material_too(tmp_path):
    (tmp_path / "room.obj").write_text(prism_obj(box_plan(6.0, 4.0), 3.0, "carpet_thin"))
    for room in (roomeq.Room(tmp_path / "room.obj", 0.3), roomeq.Room(tmp_path / "room.obj", dict(absorption=0.3))):
        assert np.all(room.scene().absorption == 0.3)
    named = roomeq.Room(tmp_path / "room.obj", {"default": 0.3}).scene()
    assert named.absorption[named.room.surfaces.index("carpet_thin")].max() > 0.3


def test_mesh_is_a_room(tmp_path):
    (tmp_path / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    room = roomeq.Room(tmp_path / "l.obj", materials=0.2)
    rir = roomeq.simulate_rir(room, (1.0, 1.0, 1.5), (2.0, 1.2, 1.2), 8000, num_rays=500)
    assert np.any(rir)


@pytest.mark.parametrize("directivity", DIRECTIVITIES, ids=lambda one: type(one).__name__)
def test_directivity_acts_at_the_microphone_as_at_the_source(directivity):
    """A room is reciprocal: exchanging source and microphone, with their directivities, changes nothing."""
    at_source, at_mic = ([], [])
    for seed in range(12):
        at_source.append(roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, source_directivity=directivity, seed=seed))
        at_mic.append(roomeq.simulate_rir(ROOM, MIC_M, SOURCE_M, mic_directivity=directivity, seed=seed))
    level_db = [np.mean([10.0 * np.log10(np.sum(rir ** 2)) for rir in rirs]) for rirs in (at_source, at_mic)]
    drr_db, c50_db, t20_s = ([np.mean([parameters(rir)[key] for rir in rirs], axis=0) for rirs in (at_source, at_mic)]
                             for key in ("drr_db", "c50_db", "t20_s"))
    assert level_db[0] == pytest.approx(level_db[1], abs=0.3)
    assert drr_db[0] == pytest.approx(drr_db[1], abs=0.3)
    assert c50_db[0][2:] == pytest.approx(c50_db[1][2:], abs=1.0)
    assert t20_s[0][2:] == pytest.approx(t20_s[1][2:], rel=0.1)


def test_cardioid_that_faces_away_mutes_the_direct_sound_and_a_figure_eight_inverts_it():
    towards = np.subtract(MIC_M, SOURCE_M)
    first = round(direct_sample())
    direct = {}
    for pattern in ("omnidirectional", "cardioid", "figure_eight"):
        rir = roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, source_directivity=roomeq.FirstOrder(pattern, -towards))
        direct[pattern] = np.sum(rir[first - 2:first + 3])
    assert abs(direct["cardioid"]) < 0.02 * direct["omnidirectional"]
    assert direct["figure_eight"] == pytest.approx(-direct["omnidirectional"], rel=0.05)


def test_cardioid_in_a_diffuse_field_takes_a_third_of_the_energy():
    room = roomeq.Room((6.0, 4.0, 3.0), materials={"absorption": 0.1, "scattering": 0.9})
    late = {}
    for pattern in ("omnidirectional", "cardioid"):
        rirs = roomeq.simulate_rir(room, SOURCE_M, [MIC_M, (1.0, 3.0, 1.0), (5.0, 1.0, 2.0)],
                                   mic_directivity=roomeq.FirstOrder(pattern, (0.0, 0.0, 1.0)))
        late[pattern] = np.sum(rirs[:, 2400:] ** 2)
    assert 10.0 * np.log10(late["cardioid"] / late["omnidirectional"]) == pytest.approx(-4.77, abs=0.4)


def test_table_of_a_cardioid_acts_like_the_cardioid():
    directions = np.random.default_rng(0).standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    gains_db = 20.0 * np.log10(np.maximum(0.5 + 0.5 * directions[:, :1], 1e-3))
    facing = (0.3, -1.0, 0.4)
    table = roomeq.DirectivityTable(directions, [100.0, 10000.0], np.repeat(gains_db, 2, axis=1), facing)
    tested = np.random.default_rng(1).standard_normal((50, 3))
    tested /= np.linalg.norm(tested, axis=1, keepdims=True)
    expected = roomeq.FirstOrder("cardioid", facing).pressure(tested, 16000)
    assert table.pressure(tested, 16000) == pytest.approx(expected, abs=0.03)


def test_long_reverberation_is_not_cut_off():
    rir = roomeq.simulate_rir(roomeq.Room((6, 4, 3), t60_s=5.0), SOURCE_M, MIC_M)
    assert len(rir) > 5.0 * 16000
    parameters = roomeq.analyse(rir, 16000)
    assert parameters["t30_valid"][4] and parameters["t30_s"][4] == pytest.approx(5.0, rel=0.05)


def test_decay_much_slower_than_in_a_diffuse_field_is_not_cut_off():
    """Along a corridor, sound decays for 5 s (an independent Monte Carlo simulation), not for 2 s as Eyring says."""
    corridor = roomeq.Room((40, 2, 2.6), dict(absorption=0.05, scattering=0.02))
    rir = roomeq.simulate_rir(corridor, (2, 1, 1.5), (10, 0.7, 1.6))
    parameters = roomeq.analyse(rir, 16000)
    assert parameters["t30_valid"][4] and parameters["t30_s"][4] == pytest.approx(4.9, rel=0.15)


def test_rooms_and_sources_have_tails_of_their_own():
    tails = [roomeq.simulate_rir(roomeq.Room(dims_m, t60_s=0.6), source_m, (3.0, 2.5, 1.1))[2000:6000]
             for dims_m, source_m in (((6, 4, 3), (1, 1, 1.5)), ((6, 4, 3), (1.5, 1, 1.5)), ((6, 4.5, 3), (1, 1, 1.5)))]
    correlation = np.corrcoef(tails) - np.eye(3)
    assert np.abs(correlation).max() < 0.1


@pytest.mark.parametrize(("wrong", "message"), [
    (lambda: roomeq.Room((6, 4, 3)), "needs materials or t60_s"),
    (lambda: roomeq.Room((6, 4), materials=0.1), "three lengths"),
    (lambda: roomeq.Room((6, 4, 3), materials=1.5), r"must lie in \[0, 1\]"),
    (lambda: roomeq.Room((6, 4, 3), materials="brik_plastered"), "closest: brick_plastered"),
    (lambda: roomeq.Room((6, 4, 3), {"absorption": 0.2, "scatering": 0.9}), "key 'scatering' must be one of material"),
    (lambda: roomeq.Room(600, t60_s=0.5), "geometry=600 must be three lengths"),
    (lambda: roomeq.Room((6, 4, 3), t60_s="0.5"), "t60_s='0.5' must be a number"),
    (lambda: roomeq.Room((6, None, 3), t60_s=0.5), r"room_dims_m=\[6.0, None, 3.0\] must be three lengths"),
    (lambda: roomeq.Room((6, 4, 3), t60_s=0.5, temperature_c="20"), "temperature_c='20' must be a number"),
    (lambda: roomeq.Room((6, 4, 3), t60_s=0.5, humidity_pct=None), "humidity_pct=None must be a number"),
    (lambda: roomeq.Room((6, 4, 3), materials=True), "absorption=True of material 'own' must be 8 numbers"),
    (lambda: roomeq.Room((6, 4, 3), materials=["0.1"] * 8), r"absorption=\('0.1', .* must be 8 numbers"),
    (lambda: roomeq.Room((6, 4, 3), materials={"absorption": 0.1, "scattering": {}}), "scattering={} of material"),
    (lambda: roomeq.simulate_rir((6, 4, 3), SOURCE_M, MIC_M), r"room is a tuple and must be a Room"),
    (lambda: roomeq.simulate_rir(roomeq.Room((6, 4, 3), 0.2).scene(), SOURCE_M, MIC_M),
     r"room is a Scene and must be a Room: give Room\(geometry, materials=\.\.\.\), or call simulate_responses with a "
     "Scene"),
    (lambda: roomeq.simulate_rir(ROOM, "here", MIC_M), "source='here' must be coordinates"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, [(1, 1, 1), (2, 1)]), "mics=.* must be coordinates"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, num_rays=True), "num_rays=True must be a whole number"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, fs=None), "fs=None must be"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, "16000"), "fs='16000' must be"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, seed=1.5), "seed=1.5 must be a whole number"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, num_rays=10 ** 9), "num_rays=1000000000 must be"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, source_directivity="cardioid"), "directivity='cardioid' must"),
    (lambda: roomeq.Room((6, 4, 3), t60_s=20.0), r"t60_s=20.0 must be a number in \[0.05, 10\]"),
    (lambda: roomeq.simulate_rir(ROOM, (7, 1, 1), MIC_M), r"source_pos_m\[0\]=7"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, [1.0, 2.0]), "must have the shape"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, 96000), "fs=96000 must be"),
    (lambda: roomeq.simulate_rir(ROOM, SOURCE_M, MIC_M, mic_directivity=[None, None]), "2 directivities"),
    (lambda: roomeq.FirstOrder("cardoid", (1, 0, 0)), "must be one of omnidirectional"),
    (lambda: roomeq.FirstOrder("cardioid", (0, 0, 0)), "not all 0"),
    (lambda: roomeq.Loudspeaker((1, 0, 0), radius_m=0.05, membrane_radius_m=0.1), "membrane_radius_m=0.1"),
    (lambda: roomeq.DirectivityTable(np.eye(3), [100.0], np.zeros((2, 1)), (1, 0, 0)), "one row for each"),
    (lambda: roomeq.FirstOrder(None, (1, 0, 0)), "pattern=None must be one of omnidirectional"),
    (lambda: roomeq.FirstOrder("cardioid", "front"), "direction='front' must be numbers"),
    (lambda: roomeq.Loudspeaker((1, 0, 0), radius_m="0.1"), "radius_m='0.1' must be a number"),
    (lambda: roomeq.Loudspeaker((1, 0, 0), membrane_radius_m=None), "membrane_radius_m=None must be a number"),
    (lambda: roomeq.DirectivityTable([(1, 0, 0), (0, 0, 0)], [100.0], np.zeros((2, 1)), (1, 0, 0)),
     r"directions\[1\]=\[0.0, 0.0, 0.0\] must be three finite numbers, not all 0"),
    (lambda: roomeq.DirectivityTable("sphere", [100.0], np.zeros((2, 1)), (1, 0, 0)), "directions='sphere' must be"),
    (lambda: roomeq.DirectivityTable(np.eye(3), 100.0, np.zeros((3, 1)), (1, 0, 0)), "one column for each"),
])
def test_wrong_arguments_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


def test_all_octaves_of_a_noiseless_response_are_valid():
    """The last blocks of a sparse tail may seem to rise: the decay before them holds."""
    materials = {"ceiling": "mineral_fibre_ceiling", "floor": "carpet_thin", "default": "brick_plastered"}
    rir = roomeq.simulate_rir(roomeq.Room((5.8, 4.1, 2.6), materials, t60_s=0.38), (1.6, 1.2, 1.2), (4.0, 2.9, 1.3),
                              seed=1)
    found = roomeq.analyse(rir, 16000)
    assert all(found["t30_valid"]) and all(found["c50_valid"]) and min(found["decay_range_db"]) > 50.0


def test_target_between_two_renderings_is_met():
    """The predicted T30 jumps there: corrections of the aim alone would swing between 0.54 and 0.67 s."""
    materials = {"floor": "carpet_on_felt", "ceiling": "mineral_fibre_ceiling", "default": "gypsum_board_on_studs"}
    mics_m = [(4.0, 3.0, 1.2), (4.05, 3.0, 1.2)]
    rirs = roomeq.simulate_rir(roomeq.Room((6, 4, 3), materials, t60_s=0.6), (2.0, 1.5, 1.5), mics_m, seed=9)
    assert np.mean([roomeq.analyse(rir, 16000)["t30_s"][4] for rir in rirs]) == pytest.approx(0.6, rel=0.05)
