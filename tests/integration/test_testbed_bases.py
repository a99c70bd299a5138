"""Rooms that pyroomacoustics simulates against those of the testbed's own base, and against its own rendering."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from roomeq.records.rir_dir import read_rirs
from testbed import KINDS, bases, make_room_set
from testbed.bases import PYROOMACOUSTICS, base_named, room_set_fields
from testbed.draws import C0, DECLARED_C, DECLARED_PCT, FS_HZ, N_BANDS, N_FFT, N_SAMPLES, OCTAVES_HZ
from testbed.fields import AIRS
from testbed.paths import OWN
from testbed.render import render
from testbed.size import cells
from testbed.trace import COHERENT_ORDER

SEED = 3
AIR = (DECLARED_C, DECLARED_PCT)


def test_a_base_that_nobody_has_is_refused(tmp_path):
    with pytest.raises(ValueError, match="base='odeon' must be one of testbed, pyroomacoustics"):
        make_room_set("clean", 1.0, SEED, tmp_path, base="odeon")


def test_without_pyroomacoustics_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, PYROOMACOUSTICS, None)
    monkeypatch.delitem(sys.modules, "testbed.pyroom", raising=False)
    monkeypatch.delattr(sys.modules["testbed"], "pyroom", raising=False)
    with pytest.raises(ValueError, match="^base='pyroomacoustics' needs pyroomacoustics: pip install"):
        base_named.__wrapped__(PYROOMACOUSTICS)


@pytest.fixture(scope="module")
def pyroom():
    pytest.importorskip("pyroomacoustics")
    from testbed import pyroom
    return pyroom


@pytest.fixture(scope="module")
def both(pyroom, tmp_path_factory):
    """Fields of the same two rooms from either base."""
    cache = tmp_path_factory.mktemp("traced")
    return [[field for room in room_set_fields(SEED, 2, cache, base) for field in room] for base in bases.BASES]


def specular(field):
    """Return a response without its late part, and the noise of the recorder."""
    silent = np.zeros_like(field.energy)
    return render(replace(field, energy=silent))


def test_both_have_the_same_rooms_and_places(both):
    for own, other in zip(*both, strict=True):
        assert (own.base, other.base) == (OWN, PYROOMACOUSTICS)
        assert own.rir.rir_id == other.rir.rir_id
        assert np.array_equal(own.rir.facing, other.rir.facing)
        assert np.array_equal(own.room.absorption, other.room.absorption)


def test_image_sources_agree(both):
    for own, other in zip(*both, strict=True):
        early = other.images.order <= COHERENT_ORDER
        assert other.images.order.max() == 9
        np.testing.assert_allclose(other.images.length_m[early], own.images.length_m, atol=1e-5)
        np.testing.assert_allclose(other.images.gain[:, early], own.images.gain, atol=1e-5)
        np.testing.assert_allclose(other.images.departure[early], own.images.departure, atol=1e-5)


def test_direct_sounds_arrive_alike_and_are_as_loud(both):
    for own, other in zip(*both, strict=True):
        arrival = own.images.length_m[0] / C0 * FS_HZ
        direct = slice(round(arrival) - 3, round(arrival) + 4)
        first, second = specular(own)[direct], specular(other)[direct]
        assert np.argmax(first) == np.argmax(second)
        assert np.sum(second ** 2) == pytest.approx(np.sum(first ** 2), rel=0.1)


def test_energies_agree_within_2_db(both):
    """Its rays bring 1 to 1.5 dB too much late (scattered sound is counted beside that which goes on)."""
    def total(field):
        specular_energy = np.sum((field.images.gain / (4.0 * np.pi * field.images.length_m)) ** 2, axis=1)
        return specular_energy + field.energy.sum(axis=1)

    ratio_db = 10.0 * np.log10([total(other) / total(own) for own, other in zip(*both, strict=True)])
    assert np.abs(ratio_db.mean(axis=0)) == pytest.approx(0.0, abs=1.0)
    assert np.abs(ratio_db).max() < 2.0


def test_decay_times_agree_within_a_quarter(both):
    t20 = [np.array([cells(render(field), field)["t20"] for field in fields]) for fields in both]
    assert np.nanmedian((t20[1] / t20[0])[:, 2:]) == pytest.approx(1.0, abs=0.25)


def test_late_part_is_the_simulators_own(both, pyroom):
    from pyroomacoustics.simulation.rt import compute_rt_rir
    field = both[1][3]
    octaves, taps = pyroom.set_up()
    found = np.fft.irfft(pyroom.late(field, field.energy, C0, AIR), N_FFT)[:N_SAMPLES]
    histogram = np.maximum(field.energy.reshape(N_BANDS, -1, pyroom.BINS).sum(axis=-1), 1e-30)
    pyroom.seed_by("pyroomacoustics late", field.room.seed, field.rir.rir_id)
    everywhere = dict(response=np.ones(1), is_impulse_response=False)
    expected = compute_rt_rir(field.images.length_m[0] / C0, [histogram], everywhere, pyroom.BIN_S,
                              round(pyroom.BIN_S * FS_HZ), field.room.volume_m3, taps, C0, FS_HZ, octaves.bank,
                              air_abs_coeffs=pyroom.air_coefficients(AIR))
    np.testing.assert_allclose(found, expected[taps // 2:][:N_SAMPLES], atol=1e-6 * np.abs(expected).max())


def test_specular_part_has_the_level_of_the_simulators_own(both, pyroom):
    """Its own is of zero phase where nothing is directive; paths that overlap then add up a little otherwise."""
    from pyroomacoustics.simulation.ism import compute_ism_rir
    field = both[1][3]
    octaves, taps = pyroom.set_up()
    box = pyroom.pair(field.room, field.rir)
    box.image_source_model()
    own = compute_ism_rir(box.sources[0], field.room.mics_m[field.rir.mic], None, box.sources[0].directions[0],
                          box.visibility[0][0] > 0, taps, C0, FS_HZ, octaves.bank,
                          air_abs_coeffs=pyroom.air_coefficients(AIR))[taps // 2:] / (4.0 * np.pi)
    pressure = field.images.gain / (4.0 * np.pi * field.images.length_m)
    found = np.fft.irfft(pyroom.pulses(field.images.length_m, pressure, C0, AIR), N_FFT)[:len(own)]
    level_db = 10.0 * np.log10(np.sum(octaves.bank.analysis(found) ** 2, axis=0)
                               / np.sum(octaves.bank.analysis(own) ** 2, axis=0))
    assert level_db == pytest.approx(0.0, abs=1.0)


def test_filters_of_the_walls_are_the_simulators_own_and_come_with_the_pulse(pyroom):
    octaves, _ = pyroom.set_up()
    coefficients = np.random.default_rng(1).uniform(0.2, 1.0, (3, N_BANDS))
    found = octaves.synthesis(coefficients, min_phase=True)
    np.testing.assert_allclose(found, octaves.bank.synthesis(coefficients, min_phase=True), atol=1e-9)
    assert np.sum(found[:, :64] ** 2, axis=1) == pytest.approx(np.sum(found ** 2, axis=1), rel=0.1)


def test_air_wears_off_what_travels_far(pyroom):
    """ISO 9613-1 in the middle of each octave: 10 m and 100 m."""
    far = [pyroom.pulses(np.array([length]), np.ones((N_BANDS, 1)), C0, AIRS[0]) for length in (10.0, 100.0)]
    lost_db = -20.0 * np.log10(np.abs(far[1] / far[0]))
    frequency = np.fft.rfftfreq(N_FFT, 1.0 / FS_HZ)
    expected = 90.0 * 10.0 / np.log(10.0) * pyroom.air_coefficients(AIRS[0])
    assert np.interp(OCTAVES_HZ[3:7], frequency, lost_db) == pytest.approx(expected[3:7], rel=0.2, abs=0.1)


def test_a_directive_source_changes_rays_by_the_angles_that_they_left_at(both):
    """Over the angles, shares of what the rays bring add up to one; behind a narrow beam little is left."""
    kind = KINDS["source_directivity"]
    extra = kind.extra(kind.draw(SEED, []), 4.0)
    for field in both[1]:
        assert field.share.sum(axis=0) == pytest.approx(1.0, abs=0.01)
    rirs = [render(replace(field, images=replace(field.images, gain=0.0 * field.images.gain)), [extra])
            for field in both[1]]
    plain = [render(replace(field, images=replace(field.images, gain=0.0 * field.images.gain))) for field in both[1]]
    assert all(np.sum(rir ** 2) < 0.6 * np.sum(before ** 2) for rir, before in zip(rirs, plain, strict=True))


def test_a_set_says_its_base_and_has_the_same_bytes_again(pyroom, tmp_path):
    for part in "ab":
        truth = make_room_set("source_response", 2.0, SEED, tmp_path / part, n_fit=1, n_judge=1,
                              cache=tmp_path / "traced", base=PYROOMACOUSTICS)
    assert truth["base"] == PYROOMACOUSTICS
    assert truth["achieved_jnd"]["source_response"] == pytest.approx(2.0, rel=0.1)
    for row in read_rirs(tmp_path / "a/fit"):
        wav = f"fit/{row['wav']}"
        assert (tmp_path / "a" / wav).read_bytes() == (tmp_path / "b" / wav).read_bytes()
