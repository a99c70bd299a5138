"""The generated rooms: their physics, and that each effect changes what it should."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roomeq.acoustics.direct import find_direct
from roomeq.records.rir_dir import read_rirs, validate_rirs
from testbed import KINDS, make_room_set
from testbed.air import absorption_db_per_m, through_air
from testbed.bands import band_gains
from testbed.bases import BASES, PYROOMACOUSTICS, room_set_fields
from testbed.draws import C0, FREQUENCY_HZ, FS_HZ, N_FFT, N_SAMPLES, speed_of_sound
from testbed.paths import image_sources
from testbed.render import render
from testbed.screen import past_screen
from testbed.size import cells, changes, mean_size
from testbed.waves import impedance_of, random_incidence, responses

SEED = 3
FORBIDDEN = ("roomeq.sim", "roomeq.effects", "roomeq.loop")
TOUCHED = dict(
    air_absorption="t30", sound_speed="arrival", source_response="direct", mic_response="direct",
    source_directivity="direct", occlusion="direct", coupled_volume="t30", room_modes="eq", near_reflector="direct",
    noise_floor="floor", clock_drift="arrival", harmonic_distortion="ahead", ringing_object="t30")
"""A metric that each effect must change."""

LEFT = dict(
    air_absorption="arrival", sound_speed="drr", source_response="ahead", mic_response="ahead",
    source_directivity="arrival", occlusion="floor", coupled_volume="arrival", room_modes="arrival",
    near_reflector="floor", noise_floor="arrival", clock_drift="floor", harmonic_distortion="t30",
    ringing_object="direct")
"""... and one that it must leave alone."""


@pytest.fixture(scope="module", params=BASES)
def rooms(request, tmp_path_factory):
    """Fields of two rooms, of each base."""
    if request.param == PYROOMACOUSTICS:
        pytest.importorskip("pyroomacoustics")
    return room_set_fields(SEED, 2, tmp_path_factory.mktemp("traced"), request.param)


@pytest.fixture(scope="module")
def pairs(rooms):
    """Some of their pairs, with both loudspeakers and both microphones."""
    return [field for room in rooms for field in room[::3]]


@pytest.fixture(scope="module")
def clean(pairs):
    return [render(field) for field in pairs]


def test_nothing_here_comes_from_what_it_judges():
    for path in (Path(__file__).parents[1] / "testbed").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, (ast.Import, ast.ImportFrom)) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                names = [f"{node.module}.{name}" for name in names]
            assert not any(name.startswith(FORBIDDEN) for name in names), f"{path} imports {names}"


def test_every_effect_is_tested():
    assert set(TOUCHED) == set(LEFT) == set(KINDS)


@pytest.mark.parametrize("name", KINDS)
def test_an_effect_changes_what_it_should_and_nothing_else(name, rooms, pairs, clean):
    kind = KINDS[name]
    drawn = kind.draw(SEED, [room[0].room for room in rooms])
    json.dumps(drawn)
    low, high = kind.scales
    measured = [cells(rir, field) for rir, field in zip(clean, pairs, strict=True)]
    size = {}
    for scale in (low, low ** 0.25 * high ** 0.75):
        extra = [kind.extra(drawn, scale)]
        size[scale] = changes(measured, [cells(render(field, extra), field) for field in pairs])
    faint, clear = size.values()
    assert np.nanmax(np.abs(clear[TOUCHED[name]])) > 0.5
    assert np.nanmean(np.abs(clear[LEFT[name]])) < 0.15
    assert np.nanmean(np.abs(faint[TOUCHED[name]])) < np.nanmean(np.abs(clear[TOUCHED[name]]))


@pytest.mark.parametrize("kind", ["clean", "source_response+noise_floor"])
def test_a_room_set_keeps_the_contract(kind, tmp_path):
    truth = make_room_set(kind, 1.0, SEED, tmp_path, n_fit=2, n_judge=1, cache=tmp_path / "traced")
    assert validate_rirs(tmp_path / "fit") == 16
    assert validate_rirs(tmp_path / "test") == 8
    fit, test = (read_rirs(tmp_path / part) for part in ("fit", "test"))
    assert not {row["room_id"] for row in fit} & {row["room_id"] for row in test}
    for room in {row["room_id"] for row in fit}:
        assert len({(row["source_id"], row["mic_id"]) for row in fit if row["room_id"] == room}) == 4
    for name, achieved in truth["achieved_jnd"].items():
        assert name in kind and achieved == pytest.approx(1.0, rel=0.1)
    assert json.loads((tmp_path / "truth.json").read_text())["kind"] == kind
    assert not any(name in json.dumps(fit) for name in KINDS)


def test_the_same_room_set_has_the_same_bytes(tmp_path):
    for part in "ab":
        make_room_set("noise_floor", 2.0, SEED, tmp_path / part, n_fit=1, n_judge=1, cache=tmp_path / f"traced-{part}")
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*") if path.is_file())
    assert len(files) > 16
    for file in files:
        if file.name != "rir_list":  # names the folder
            assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_declared_positions_are_off_by_centimetres(rooms):
    off = np.array([[field.rir.declared_source_m - field.room.sources_m[field.rir.source],
                     field.rir.declared_mic_m - field.room.mics_m[field.rir.mic]] for room in rooms for field in room])
    assert 0.014 < off.std() < 0.026


def test_the_direct_sound_arrives_when_and_as_loud_as_it_must(pairs, clean):
    for field, rir in zip(pairs, clean, strict=True):
        distance = np.linalg.norm(field.room.sources_m[field.rir.source] - field.room.mics_m[field.rir.mic])
        sample, _ = find_direct(rir, FS_HZ, distance / C0 * FS_HZ)
        assert sample == pytest.approx(distance / C0 * FS_HZ, abs=0.1)
        near = slice(round(sample) - 8, round(sample) + 9)
        specular = render(replace(field, energy=np.zeros_like(field.energy)))
        assert np.sum(specular[near]) * 4 * np.pi * distance == pytest.approx(1.0, abs=0.15)


def test_decay_times_are_near_eyring(pairs, clean):
    """Within 35 %: absorption is uneven, scattering partial, and the formula wants a diffuse field."""
    for field, rir in zip(pairs, clean, strict=True):
        t20, expected = cells(rir, field)["t20"][2:6], field.room.eyring_s[2:6]
        assert np.nanmean(t20 / expected) == pytest.approx(1.15, abs=0.35)


def test_late_energy_agrees_with_the_image_sources_of_a_hard_box(rooms):
    """What one ray carries is what one image source carries: scattered and specular orders join without a step."""
    field = rooms[0][0]
    images = image_sources(field.room, field.room.sources_m[0], field.room.mics_m[0])
    assert images.length_m[0] == pytest.approx(np.linalg.norm(field.room.sources_m[0] - field.room.mics_m[0]))
    assert np.all(images.gain[:, 0] == 1.0) and np.all(images.gain[:, 1:] < 1.0)
    first = np.flatnonzero(field.energy[4])[0] * 1e-3 * C0
    assert first > images.length_m[0] - 1.0


def test_air_is_the_standards():
    """ISO 9613-1, table 1: 20 degrees C, 50 %; 10 degrees C, 20 % [dB/km], three digits."""
    found = absorption_db_per_m(1000.0 * 10.0 ** (0.3 * np.array([0, 2, 3])), 20.0, 50.0) * 1e3
    assert found == pytest.approx([4.66, 29.4, 104.0], rel=0.01)
    pulse = np.zeros(N_SAMPLES)
    pulse[8000] = 1.0
    worn = np.abs(np.fft.rfft(through_air(pulse, 20.0, 50.0)))
    expected = 10.0 ** (-absorption_db_per_m(np.fft.rfftfreq(N_SAMPLES, 1 / FS_HZ), 20.0, 50.0) * 0.5 * C0 / 20.0)
    assert 20 * np.log10(worn / expected) == pytest.approx(0.0, abs=0.1)


def test_bands_add_up_to_one():
    assert band_gains(4096).sum(axis=0) == pytest.approx(1.0, abs=1e-12)


def test_a_hotter_room_is_faster(pairs, clean):
    kind = KINDS["sound_speed"]
    extra = [kind.extra(kind.draw(SEED, []), 1.0)]
    for field, before in zip(pairs[:4], clean, strict=False):
        expected = field.images.length_m[0] * FS_HZ
        early = find_direct(render(field, extra), FS_HZ, expected / C0)[0]
        late = find_direct(before, FS_HZ, expected / C0)[0]
        assert late - early == pytest.approx(expected / C0 - expected / speed_of_sound(35.0), abs=0.1)


def test_a_screen_lets_half_of_the_pressure_by_at_its_edge_and_all_of_it_where_it_is_tiny():
    f = np.array([500.0, 2000.0, 8000.0])
    edge = past_screen(1.5, 1.5, 0.0, 50.0, (1.0, 1.0), (100.0, 50.0), f)
    assert np.abs(edge) == pytest.approx(0.5, abs=0.02)
    assert np.abs(past_screen(1.5, 1.5, 0.0, 0.0, (1.0, 1.0), (1e-4, 1e-4), f)) == pytest.approx(1.0, abs=0.01)


def test_a_screen_shadows_as_maekawas_chart_says():
    """One edge, Fresnel numbers 0.3 to 10: within 3 dB of 10 lg(3 + 20 N) (Maekawa, Appl. Acoust. 1 (1968) 157)."""
    depth = np.linspace(0.15, 0.9, 6)
    for x in depth:
        detour = 2.0 * (np.hypot(1.5, x) - 1.5)
        n = 2.0 * detour * 1000.0 / 343.0
        loss = -20 * np.log10(np.abs(past_screen(1.5, 1.5, 100.0 - x, 0.0, (1, 1), (100.0, 100.0), np.array([1000.0]))))
        assert loss[0] == pytest.approx(10 * np.log10(3 + 20 * n), abs=3.0)


def test_wave_field_has_the_modes_of_the_box():
    dims = np.array([5.0, 4.1, 2.7])
    pressure, step_s = responses(dims, np.array([0.3, 0.3, 0.3]), np.array([[4.8, 3.9, 2.5]]), [200.0] * 6, 2.0)
    f = np.arange(25.0, 90.0, 0.1)
    kernel = np.exp(-2j * np.pi * np.outer(f, np.arange(pressure.shape[1]) * step_s))
    level = np.abs(kernel @ (pressure[0] * np.hanning(pressure.shape[1])))
    peaks = f[1:-1][(level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])]
    for order in ([1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]):
        mode = C0 / 2.0 * np.linalg.norm(np.array(order) / dims)
        assert np.min(np.abs(peaks - mode)) < 0.01 * mode


def test_wave_field_starts_as_a_spherical_wave():
    """Before the first reflection: arrival and 1/(4 pi r), in the band that the grid carries."""
    dims = np.array([9.0, 9.0, 9.0])
    pressure, step_s = responses(dims, dims / 2, np.array([[6.0, 4.5, 4.5]]), [1.5] * 6, 0.02)
    f = np.array([100.0, 200.0])
    found = np.exp(-2j * np.pi * np.outer(f, np.arange(pressure.shape[1]) * step_s)) @ pressure[0]
    assert np.abs(found) * 4 * np.pi * 1.5 == pytest.approx(1.0, abs=0.1)


def test_wave_field_takes_the_place_of_rays_below_the_crossover():
    """Of the early pulses, nothing is left there; ahead of the direct sound, nothing is added."""
    kind, field = KINDS["room_modes"], room_set_fields(SEED, 1)[0][0]
    extra = kind.extra({}, 100.0)
    transfer, share, _ = extra.wave(field)
    low = (FREQUENCY_HZ > 30.0) & (FREQUENCY_HZ < 80.0)
    assert np.all(share[low] == 1.0) and np.all(share[FREQUENCY_HZ > 120.0] < 1e-9)
    silent = replace(field, energy=np.zeros_like(field.energy))  # no late field, and no noise worth mentioning
    rir = render(silent, [extra])
    error = np.fft.rfft(rir, N_FFT)[low] - transfer[low]
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(transfer[low])
    arrival = int(field.images.length_m[0] / C0 * FS_HZ)
    ahead = rir[:arrival - 20] - render(silent)[:arrival - 20]
    assert np.abs(ahead).max() < 1e-6 * np.abs(rir).max()


def test_walls_of_the_wave_field_absorb_what_is_asked():
    for absorption in (0.05, 0.2, 0.6):
        assert random_incidence(impedance_of(absorption)) == pytest.approx(absorption, rel=1e-6)


def test_the_desk_makes_a_comb(rooms, pairs):
    kind = KINDS["near_reflector"]
    extra = [kind.extra(kind.draw(SEED, [room[0].room for room in rooms]), 1.0)]
    field = pairs[0]
    added = render(field, extra) - render(field)
    first = np.flatnonzero(np.abs(added) > 0.5 * np.abs(added).max())[0]
    assert first > field.images.length_m[0] / C0 * FS_HZ
    spectrum = np.abs(np.fft.rfft(added, len(FREQUENCY_HZ) * 2))
    assert spectrum[10000] > 3 * spectrum[20]


def test_size_of_nothing_is_nothing(pairs, clean):
    measured = [cells(clean[0], pairs[0])]
    assert mean_size(changes(measured, measured)) == 0.0


def test_an_unknown_kind_is_refused(tmp_path):
    with pytest.raises(ValueError, match="kind='ghosts' must be clean or one of air_absorption"):
        make_room_set("ghosts", 1.0, 1, tmp_path)
