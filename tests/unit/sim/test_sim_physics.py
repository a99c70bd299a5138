"""The simulator against physics that can be computed otherwise."""

from itertools import product

import numpy as np
import pytest
from decays import reverberation_time

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.filterbank import thirds_of_octaves
from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.octaves import octave_bands
from roomeq.core.constants import BAND_1KHZ, EXACT_BANDS_HZ, FS_HZ
from roomeq.sim.echogram import FRAME_S, compute_echograms
from roomeq.sim.images import specular_paths
from roomeq.sim.render import MAX_LENGTH_S, _in_thirds, render, tail_noise
from roomeq.sim.response import decay_length_s, needed_length_s, render_responses, simulate_responses, trace_source
from roomeq.sim.room import Walls
from roomeq.sim.scene import Air, Material, Scene, Shoebox, eyring_time_s
from roomeq.sim.target import scaled_absorption
from roomeq.sim.trace import sphere_directions, trace

C = Air().speed_m_s


def uniform_scene(dims_m, absorption, scattering):
    return Scene(Shoebox(dims_m), [Material("all", absorption, scattering)] * 6)


def places(room, count, seed):
    return np.random.default_rng(seed).uniform(0.15, 0.85, (count, 3)) * room.dims_m


def test_absorption_is_raised_to_what_the_traced_rays_serve_in_the_bands_that_need_it():
    expected = np.full((6, 8), 0.2)
    traced = trace_source(uniform_scene((5.0, 4.0, 3.0), 0.2, 0.3), (1.0, 1.0, 1.5), num_rays=100, absorption=expected,
                          rng=np.random.default_rng(0))
    absorption = np.full((6, 8), 0.3)
    absorption[:, 0] = [0.02, 0.02, 0.5, 0.02, 0.02, 0.02]
    absorption[:, 1] = 0.02
    served = traced.served(absorption)
    assert not traced.serves(absorption) and traced.serves(served)
    assert np.all(served[:, 2:] == 0.3) and served[2, 0] == 0.5 and 0.09 < served[0, 1] < 0.1


@pytest.mark.parametrize("distance_m", [0.7, 2.0, 3.217])
def test_direct_sound_follows_inverse_distance_and_delay(distance_m):
    scene = uniform_scene((8.0, 5.0, 3.0), 1.0, 0.0)
    (response,) = simulate_responses(scene, (2.0, 2.0, 1.5), (2.0 + distance_m, 2.0, 1.5), num_rays=200)
    assert response.direct_sample == pytest.approx(FS_HZ * distance_m / C)
    sample, polarity = find_direct(response.rir, FS_HZ)
    assert polarity == 1 and sample == pytest.approx(response.direct_sample, abs=0.02)
    spectrum = np.abs(np.fft.rfft(response.rir))
    frequency = np.fft.rfftfreq(len(response.rir), 1.0 / FS_HZ)
    level_db = 20.0 * np.log10(spectrum * 4.0 * np.pi * distance_m)
    assert np.all(np.abs(level_db[(frequency > 50.0) & (frequency < 4000.0)]) < 0.1)


STEEP = np.array([1.0, 1.0, 0.5, 1.0, 0.3, 0.1, 0.03, 0.01])


def rendered_path(length_m, gains):
    return render(np.array([length_m]), gains[None], np.zeros((1, 8)), np.zeros(8000), speed_m_s=C, n_samples=8000)


def test_nothing_precedes_the_first_sound_where_gains_differ_between_octaves():
    echogram = np.outer(np.exp(-np.arange(300) / 80.0), STEEP ** 2)
    paths_m = np.array([3.4, 4.1, 6.0])
    rir = render(paths_m, np.outer([0.1, 0.2, 0.2], STEEP), 1e-3 * echogram, np.ones(8000), speed_m_s=C, n_samples=8000)
    first = int(paths_m[0] / C * FS_HZ)
    assert np.all(np.abs(rir[:first - 32]) < 1e-9 * np.abs(rir).max())


def test_first_sound_has_its_gain_in_the_middle_of_every_octave():
    spectrum = np.abs(np.fft.rfft(rendered_path(3.4, STEEP), 16000))
    at_centre = spectrum[np.round(np.array(EXACT_BANDS_HZ)).astype(int)]
    assert 20.0 * np.log10(at_centre[:7] / STEEP[:7]) == pytest.approx(np.zeros(7), abs=0.5)


def test_decay_of_an_octave_is_its_own_beside_longer_ones():
    t60_s = np.array([3.8, 2.3, 1.2, 0.5, 0.28, 0.23, 0.22, 0.21])  # of a porous absorber on all surfaces
    echogram = np.exp(-13.8 * FRAME_S * np.arange(2500)[:, None] / t60_s)
    rirs = [render(np.zeros(0), np.zeros((0, 8)), echogram, np.random.default_rng(seed).standard_normal(40000),
                   speed_m_s=C, n_samples=40000, hidden_m=0.0) for seed in range(6)]
    found_s = np.mean([all_metrics(rir, FS_HZ, 0.0, 1)["t30_s"][2:] for rir in rirs], axis=0)
    assert np.all(found_s[:3] < [1.35, 0.65, 0.3])  # 1.5, 0.84 and 0.33 s with one level in the whole octave
    assert found_s[3:] == pytest.approx(t60_s[5:], rel=0.05)


def test_thirds_of_an_octave_share_its_power():
    power = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [1.0, 0.1, 0.0], *np.ones((5, 3))])
    thirds = np.concatenate([_in_thirds(power, FS_HZ), np.zeros((1, 3))]).reshape(8, 3, 3)  # the last is above 8 kHz
    width_hz = np.diff(thirds_of_octaves(FS_HZ), axis=1)
    assert np.einsum("bk,bkn->bn", width_hz / width_hz.sum(axis=1, keepdims=True), thirds) == pytest.approx(power)
    assert np.ptp(thirds[:, :, 0]) == pytest.approx(1.0) and thirds[1, 0, 1] == 0.0
    assert thirds[4, :, 1] == pytest.approx(1.0) and thirds[1, 1, 1] > thirds[1, 2, 1] > thirds[2, 0, 1]


def test_first_sound_with_equal_gains_is_a_band_limited_pulse():
    rir, start = rendered_path(3.4, np.ones(8)), 3.4 / C * FS_HZ
    n = np.arange(int(start) - 20, int(start) + 20)
    assert rir[n] == pytest.approx(np.sinc(n - start) * np.cos(0.5 * np.pi * (n - start) / 32.0) ** 2, abs=1e-4)


def images_by_hand(dims_m, source, mic, order):
    """All image sources of a box, by reflecting positions one wall at a time."""
    found = {}
    for walls in range(order + 1):
        for sequence in product(range(6), repeat=walls):
            if any(a == b for a, b in zip(sequence, sequence[1:], strict=False)):
                continue
            image = list(source)
            for wall in sequence:
                plane_m = dims_m[wall // 2] if wall % 2 else 0.0
                image[wall // 2] = 2.0 * plane_m - image[wall // 2]
            key = tuple(round(value, 9) for value in image)
            found.setdefault(key, np.bincount(sequence, minlength=6) if sequence else np.zeros(6, int))
    keys = np.array(list(found))
    return np.linalg.norm(keys - mic, axis=1), np.array(list(found.values()))


def test_image_sources_match_brute_force():
    dims_m, source, mic = (6.0, 4.0, 3.0), (1.0, 1.3, 1.2), (4.2, 2.9, 1.7)
    distance_m, counts = images_by_hand(dims_m, source, mic, 3)
    images = specular_paths(Shoebox(dims_m), source, mic, 3)
    assert len(images.distance_m) == len(distance_m) == 63
    by_length = np.argsort(distance_m)
    np.testing.assert_allclose(images.distance_m, distance_m[by_length], atol=1e-9)
    absorption = np.linspace(0.1, 0.6, 48).reshape(6, 8)
    scattering = np.full((6, 8), 0.2)
    kept = np.prod(((1 - absorption) * (1 - scattering))[None] ** counts[by_length][:, :, None], axis=1)
    expected = np.sqrt(kept) / (4.0 * np.pi * distance_m[by_length][:, None])
    np.testing.assert_allclose(images.gains(absorption, scattering, np.zeros(8)), expected, rtol=1e-9)


@pytest.mark.parametrize("delay", [100.0, 100.25, 100.5, 1234.73])
def test_pulses_arrive_at_fractional_delays(delay):
    rir = render(np.array([delay * C / FS_HZ]), np.ones((1, 8)), np.zeros((100, 8)), np.zeros(1600),
                 speed_m_s=C, n_samples=1600)
    frequency = np.fft.rfftfreq(1600)
    spectrum = np.fft.rfft(rir) * np.exp(2j * np.pi * frequency * delay)
    below = frequency < 7000.0 / FS_HZ
    assert np.all(np.abs(20.0 * np.log10(np.abs(spectrum[below]))) < 0.1)
    assert np.all(np.abs(np.angle(spectrum[below])) < 0.01)


@pytest.mark.parametrize("scattering", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ism_order", [0, 4])
def test_energy_is_conserved_without_absorption(scattering, ism_order):
    room = Shoebox((6.0, 4.0, 3.0))
    uniform = C * FRAME_S / room.volume_m3 / (4.0 * np.pi)
    level = []
    for seed in range(3):
        source, *mics = places(room, 9, seed)
        paths = trace(room, source, np.full(6, scattering), num_rays=10000, max_length_m=0.3 * C, speed_m_s=C,
                      rng=np.random.default_rng(seed))
        energy = compute_echograms(paths, room, np.zeros((6, 8)), mics, ism_order=ism_order, n_frames=250,
                                   speed_m_s=C).energy[..., 0]
        for echogram, mic in zip(energy, mics, strict=True):
            images = specular_paths(room, source, mic, ism_order)
            gains = images.gains(np.zeros((6, 8)), np.full((6, 8), scattering), np.zeros(8))[:, 0]
            frame = (images.distance_m / C / FRAME_S).astype(int)
            np.add.at(echogram, frame[frame < 250], gains[frame < 250] ** 2)
        level.append(energy / uniform)
    mean = np.mean(level, axis=(0, 1))
    # one trace scatters by 1.4 %, because each late ray represents two
    assert np.mean(mean[60:120]) == pytest.approx(1.0, abs=0.03)
    assert np.mean(mean[150:250]) == pytest.approx(1.0, abs=0.03)


def reference_decay(dims_m, absorption, scattering, time_s, rng, n_particles=60000):
    """Total energy in a box over time: particles from random places, nothing but planes and Lambert's law."""
    size = np.array(dims_m)
    position = rng.uniform(0, 1, (n_particles, 3)) * size
    way = rng.standard_normal((n_particles, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    energy, clock = np.ones(n_particles), np.zeros(n_particles)
    total = np.zeros(len(time_s))
    while np.any(clock < time_s[-1]):
        with np.errstate(divide="ignore"):
            reach = np.where(way > 0, (size - position) / way, np.where(way < 0, -position / way, np.inf))
        axis = np.argmin(reach, axis=1)
        step = np.maximum(reach[np.arange(n_particles), axis], 0.0)
        first, clock = clock, clock + step / C
        low, high = np.searchsorted(time_s, first), np.searchsorted(time_s, clock)
        np.add.at(total, low[low < len(time_s)], energy[low < len(time_s)])
        np.add.at(total, high[high < len(time_s)], -energy[high < len(time_s)])
        position = position + step[:, None] * way
        rows = np.arange(n_particles)
        inward = np.where(way[rows, axis] > 0, -1.0, 1.0)
        diffuse = rng.random(n_particles) < scattering
        radius, angle = np.sqrt(rng.random(n_particles)), rng.uniform(0, 2 * np.pi, n_particles)
        turned = np.empty_like(way)
        turned[rows, axis] = inward * np.sqrt(1.0 - radius ** 2)
        turned[rows, (axis + 1) % 3] = radius * np.cos(angle)
        turned[rows, (axis + 2) % 3] = radius * np.sin(angle)
        way[rows, axis] *= -1.0
        way = np.where(diffuse[:, None], turned, way)
        energy = energy * (1.0 - absorption)[2 * axis + (inward < 0)]
    return np.cumsum(total)


def decay_time_s(energy, step_s, top_db=-5.0, bottom_db=-25.0):
    """Decay time by the slope of a Schroeder curve."""
    curve = np.cumsum(energy[::-1])[::-1]
    level = 10.0 * np.log10(np.maximum(curve / curve[0], 1e-30))
    chosen = (level <= top_db) & (level >= bottom_db)
    return -60.0 / np.polyfit(np.flatnonzero(chosen) * step_s, level[chosen], 1)[0]


@pytest.mark.parametrize("scattering", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("absorption", [(0.2,) * 6, (0.1, 0.1, 0.1, 0.1, 0.1, 0.6)], ids=["even", "ceiling"])
def test_decay_matches_independent_monte_carlo(scattering, absorption):
    dims_m, absorption = (6.0, 4.0, 3.0), np.array(absorption)
    time_s = np.arange(0.0, 1.2, 0.002)
    rng = np.random.default_rng(7)
    expected_s = decay_time_s(reference_decay(dims_m, absorption, scattering, time_s, rng), 0.002)
    scene = Scene(Shoebox(dims_m), [Material("wall", value, scattering) for value in absorption], Air(20.0, 50.0))
    found_s = []
    for seed in range(6):
        source, *mics = places(scene.room, 7, seed)
        traced = trace_source(scene, source, num_rays=6000, max_length_s=1.2, rng=np.random.default_rng(seed))
        rngs = [np.random.default_rng([seed, n]) for n in range(len(mics))]
        # 250 Hz: no air to speak of
        found_s += [reverberation_time(response.rir, FS_HZ, 250.0, "t20", direct_sample=response.direct_sample)
                    for response in render_responses(traced, mics, rngs)]
    assert np.mean(found_s) == pytest.approx(expected_s, rel=0.05)


def test_diffuse_room_decay_matches_kuttruff():
    scene = uniform_scene((5.0, 4.5, 4.0), 0.3, 1.0)
    source, *mics = places(scene.room, 12, 1)
    responses = simulate_responses(scene, source, np.array(mics), num_rays=6000)
    times_s = [reverberation_time(one.rir, FS_HZ, 500.0, "t20", direct_sample=one.direct_sample) for one in responses]
    # free paths vary (their relative variance is 0.4 in such rooms): Kuttruff, eq. 5.24
    expected_s = eyring_time_s(scene)[3] / (1.0 + 0.5 * 0.4 * np.log(0.7))
    assert np.mean(times_s) == pytest.approx(expected_s, rel=0.03)


def test_late_energy_matches_diffuse_field_theory():
    scene = uniform_scene((5.0, 4.5, 4.0), 0.1, 1.0)
    rng, late = np.random.default_rng(2), []
    for seed in range(4):
        source, *mics = rng.uniform(0.02, 0.98, (9, 3)) * scene.room.dims_m
        mics = [mic for mic in mics if np.linalg.norm(mic - source) > 0.5]
        for one in simulate_responses(scene, source, mics, num_rays=4000, seed=seed):
            spectrum = np.abs(np.fft.rfft(one.rir[int(one.direct_sample) + 16:], 2 * len(one.rir))) ** 2
            hz = np.fft.rfftfreq(2 * len(one.rir), 1.0 / FS_HZ)
            late.append(np.mean(spectrum[(hz > 150.0) & (hz < 1000.0)]))  # the air takes next to nothing
    # 4 (1 - a) / (a S) of the power, over 4 pi for p^2 (Kuttruff, eq. 5.44, without the direct sound)
    expected = 4.0 * 0.9 / (0.1 * scene.room.surface_area_m2.sum()) / (4.0 * np.pi)
    assert 10.0 * np.log10(np.mean(late) / expected) == pytest.approx(0.0, abs=0.5)


def test_air_absorption_shortens_high_band_decay():
    dry = Scene(Shoebox((12.0, 8.0, 4.0)), [Material("all", 0.05, 0.5)] * 6, Air(20.0, 30.0))
    (response,) = simulate_responses(dry, (3, 2, 1.5), (8, 6, 1.8), num_rays=6000)
    found_s = {hz: reverberation_time(response.rir, FS_HZ, hz, "t20", direct_sample=response.direct_sample)
               for hz in (1000.0, 4000.0, 8000.0)}
    expected_s = eyring_time_s(dry)
    assert found_s[1000.0] == pytest.approx(expected_s[BAND_1KHZ], rel=0.1)
    assert found_s[4000.0] == pytest.approx(expected_s[6], rel=0.1)
    # at 16 kHz the highest octave ends at Nyquist: what is left of it late comes through its lower edge
    assert expected_s[7] < found_s[8000.0] < 0.8 * expected_s[6]


@pytest.mark.parametrize("late", [0.05, 0.5, 0.95])
def test_scattered_sound_that_comes_with_the_first_sound_keeps_its_energy(late):
    """The first sound arrives anywhere in the frame of 1 ms that holds scattered sound; none of it may come before."""
    echogram, direct_m = np.zeros((40, 8), np.float32), (5.0 + late) * FRAME_S * C
    echogram[5], echogram[6:20] = 1.0, 0.3
    noise = np.random.default_rng(0).standard_normal(1600)
    levels = []
    for arrival_m in (direct_m, 0.5 * direct_m):  # the other first sound is early enough to cut nothing off
        quiet = np.full((1, 8), 1e-9)
        levels.append([np.mean([np.sum(render(np.array([arrival_m]), quiet, echogram, np.roll(noise, shift),
                                              speed_m_s=C, n_samples=640)[:n] ** 2) for shift in range(0, 1600, 40)])
                       for n in (128, 640)])
    np.testing.assert_allclose(10.0 * np.log10(np.divide(*levels)), 0.0, atol=0.35)


def test_tail_noise_density_grows_to_gaussian():
    noise = tail_noise(48000, 200.0, C, np.random.default_rng(0))
    late = noise[16000:]
    assert np.mean(late ** 2) == pytest.approx(1.0, abs=0.03)
    assert np.mean(late ** 4) / np.mean(late ** 2) ** 2 == pytest.approx(3.0, abs=0.15)
    early, later = np.count_nonzero(noise[:400]), np.count_nonzero(noise[400:800])
    assert 0 < early < later < 400
    draws = [tail_noise(1200, 200.0, C, np.random.default_rng(seed)) for seed in range(20)]
    assert np.mean(np.square(draws)) == pytest.approx(1.0, abs=0.06)  # four standard deviations


def test_directions_are_even_and_seeded():
    points = sphere_directions(2000, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(points.T @ points / 2000, np.eye(3) / 3.0, atol=1e-3)
    assert not np.array_equal(points, sphere_directions(2000, np.random.default_rng(1)))


def test_each_scattering_column_is_traced_once():
    column = [0.1] * 4 + [0.6] * 4
    mixed = Scene(Shoebox((6, 4, 3)), [Material("mixed", 0.2, column)] * 6)
    traced = trace_source(mixed, (1, 1, 1), num_rays=500, max_length_s=0.5, rng=np.random.default_rng(0))
    assert len(traced.paths) == 2
    assert len(set(traced.trace_of_band[:4])) == len(set(traced.trace_of_band[4:])) == 1
    assert traced.paths[traced.trace_of_band[7]].scattering[0] == 0.6


def test_scaled_absorption_keeps_bounds_and_order():
    absorption = np.array([0.0, 0.1, 0.5, 1.0])
    for exponent in (0.01, 1.0, 7.0):
        scaled = scaled_absorption(absorption, exponent)
        assert scaled[0] == 0.0 and np.all(np.diff(scaled) > 0.0) and scaled[-1] <= 1.0
    np.testing.assert_allclose(scaled_absorption(absorption[:3], 1.0), absorption[:3], atol=1e-12)


@pytest.mark.parametrize("target_s, dims_m", [
    (0.25, (17.0, 12.0, 5.0)), (0.6, (4.4, 2.8, 2.6)), (1.7, (12.0, 8.0, 4.0))])
def test_t30_target_is_met_on_rendered_response(target_s, dims_m):
    absorption = (0.05, 0.1, 0.1, 0.15, 0.2, 0.25, 0.3, 0.3)
    scene = Scene(Shoebox(dims_m), [Material("a", absorption, 0.3), Material("b", 0.1, 0.1)] * 3)
    source, mic = np.multiply(dims_m, (0.3, 0.3, 0.4)), np.multiply(dims_m, (0.7, 0.6, 0.5))
    (response,) = simulate_responses(scene, source, mic, num_rays=8000, target_t60_s=target_s, seed=3)
    measured_s = reverberation_time(response.rir, FS_HZ, 1000.0, "t30", direct_sample=response.direct_sample)
    assert measured_s == pytest.approx(target_s, rel=0.05)

    assert response.t30_s == pytest.approx(measured_s, rel=1e-4)  # which seeks noise


def test_sparse_tail_of_a_corridor_is_no_noise_floor():
    """Few reflections arrive late in a corridor. Once taken for noise, they were subtracted, and T30 jumped."""
    responses = [simulate_responses(uniform_scene((50.0, 2.0, 2.5), 0.1, 0.3), (10.0, 1.1, 1.25), (38.5, 0.62, 1.05),
                                    num_rays=8000, target_t60_s=1.0, seed=seed)[0] for seed in range(3)]
    for response in responses:
        octave = octave_bands(response.rir, FS_HZ, [EXACT_BANDS_HZ[BAND_1KHZ]])[0]
        decay = np.cumsum(octave[:round(response.direct_sample):-1] ** 2)[::-1]
        decay_db = 10.0 * np.log10(decay / decay[0])
        fitted = np.flatnonzero((decay_db < -5.0) & (decay_db > -35.0))
        plain_s = -60.0 / np.polyfit(fitted / FS_HZ, decay_db[fitted], 1)[0]
        assert response.t30_s == pytest.approx(plain_s, rel=0.02) and plain_s == pytest.approx(1.0, rel=0.06)


def test_more_rays_are_a_remedy_for_a_target_out_of_reach():
    scene = Scene(Shoebox((6.0, 4.0, 3.0)), [Material("all", (0.3,) * 8, (0.02,) * 8)] * 6)
    with pytest.raises(ValueError, match=r"is out of reach: .*: choose .*, another target or more rays \(--num-rays\)"):
        simulate_responses(scene, (1, 1, 1), [(4, 3, 1.5)], num_rays=20, target_t60_s=0.3)
    simulate_responses(scene, (1, 1, 1), [(4, 3, 1.5)], num_rays=2000, target_t60_s=0.3)


def test_headset_beside_a_far_microphone_leaves_the_target_to_it():
    scene, source = uniform_scene((12.0, 8.0, 4.0), 0.1, 0.1), (4.8, 3.6, 1.6)
    headset, far = (4.86, 3.6, 1.6), (9.0, 6.0, 1.2)
    options = dict(num_rays=4000, target_t60_s=0.8)
    both = simulate_responses(scene, source, [headset, far], **options)
    assert both[1].t30_s == pytest.approx(0.8, rel=0.05)
    with pytest.raises(ValueError, match="the direct sound hides the decay at all microphones: add one further away"):
        simulate_responses(scene, source, headset, **options)


@pytest.mark.parametrize("wrong, message", [
    (lambda: Material("felt", (0.1, 0.1, 1.3, 0.1, 0.1, 0.1, 0.1, 0.1), 0.1),
     r"absorption\[2\]=1.3 of material 'felt' must lie in \[0, 1\]"),
    (lambda: Material("felt", 0.1, -0.1), r"scattering\[0\]=-0.1 of material 'felt' must lie in \[0, 1\]"),
    (lambda: Material("felt", float("nan"), 0.1), r"absorption\[0\]=nan of material 'felt'"),
    (lambda: Material("felt", (0.1, 0.2), 0.1), r"must be 8 numbers .* or one"),
    (lambda: Shoebox((4.0, 0.0, 3.0)), r"room_dims_m=.* must be three lengths"),
    (lambda: Scene(Shoebox((4.0, 3.0, 3.0)), [Material("a", 0.1, 0.1)]), r"1 materials must be one for each"),
    (lambda: simulate_responses(uniform_scene((4, 3, 3), 0.2, 0.2), (5, 1, 1), (1, 1, 1)),
     r"source_pos_m\[0\]=5 must lie in \[0.01, 3.99\] m"),
    (lambda: simulate_responses(uniform_scene((4, 3, 3), 0.2, 0.2), (1, 1, 1), (1, float("inf"), 1)),
     r"mic_pos_m.* must be three finite numbers"),
    (lambda: simulate_responses(uniform_scene((4, 3, 3), 0.2, 0.2), (1, 1, 1), (1, 1, 1.01)), r"are 0.01 m apart"),
    (lambda: simulate_responses(uniform_scene((4, 3, 3), 0.2, 0.2), (1, 1, 1), (2, 1, 1), num_rays=0),
     r"num_rays=0 must be at least 1"),
    (lambda: simulate_responses(uniform_scene((4, 3, 3), 0.0, 0.2), (1, 1, 1), (2, 1, 1), target_t60_s=0.5,
                                num_rays=500),
     r"target_t60_s=0.5 is out of reach"),
])
def test_impossible_scenes_are_rejected(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


def trace_once(room, scattering, absorption, seed=0, num_rays=20000):
    return trace(room, (1.3, 1.1, 1.4), np.full(len(room.surfaces), scattering), num_rays=num_rays,
                 max_length_m=0.8 * C, speed_m_s=C, rng=np.random.default_rng(seed), absorption=absorption)


@pytest.mark.parametrize("expected", [0.0, 0.1, 0.3, 0.38])
def test_energy_is_right_for_any_absorption_whatever_was_expected(expected):
    room, actual = Shoebox((6.0, 4.0, 3.0)), np.full((6, 8), 0.2)
    how = dict(ism_order=0, n_frames=400, speed_m_s=C)
    found, wanted = (np.mean([compute_echograms(trace_once(room, 0.3, absorption, seed), room, actual,
                                                [(4.5, 2.9, 1.6)], **how).energy[0, :, 0]
                              for seed in range(6)], axis=0) for absorption in (expected, 0.2))
    for first, tolerance_db in ((0, 0.2), (100, 0.3), (200, 0.5), (300, 0.8)):
        assert 10.0 * np.log10(found[first:first + 50].sum() / wanted[first:first + 50].sum()) == pytest.approx(
            0.0, abs=tolerance_db)


def test_rays_that_expect_much_absorption_end_sooner():
    room = Shoebox((6.0, 4.0, 3.0))
    stored = [trace_once(room, 0.3, absorption).counts.sum() for absorption in (0.05, 0.2, 0.5)]
    assert stored[0] > 1.2 * stored[1] > 1.2 * 1.2 * stored[2]


@pytest.mark.parametrize("scattering", [0.0, 0.4])
def test_box_is_traced_like_any_convex_room(scattering, monkeypatch):
    room = Shoebox((6.0, 4.0, 3.0))
    fast = trace_once(room, scattering, 0.2, num_rays=500)
    monkeypatch.setattr(Walls, "box", None)
    general = trace_once(room, scattering, 0.2, num_rays=500)
    np.testing.assert_array_equal(fast.counts, general.counts)
    for ray in range(500):
        here, there = (slice(paths.first[ray], paths.first[ray] + paths.counts[ray]) for paths in (fast, general))
        np.testing.assert_array_equal(fast.codes[here], general.codes[there])
        np.testing.assert_allclose(fast.hits[here], general.hits[there], atol=1e-4)


def test_absorption_far_below_the_expected_is_refused():
    scene = Scene(Shoebox((6.0, 4.0, 3.0)), [Material("wall", 0.5, 0.3)] * 6)
    traced = trace_source(scene, (1.3, 1.1, 1.4), num_rays=500, max_length_s=0.8, rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="absorb far less than was expected when the source was traced"):
        render_responses(traced, [(4.5, 2.9, 1.6)], [np.random.default_rng(0)], absorption=np.full((6, 8), 0.1))


def test_decay_longer_than_the_longest_response_is_said_once(caplog):
    scene = Scene(Shoebox((6, 4, 3)), [Material("steel", 0.002, 0.1)] * 6)
    assert needed_length_s(scene) == decay_length_s(scene, scene.absorption) == MAX_LENGTH_S
    (record,) = caplog.records
    decay_s = 1.3 * eyring_time_s(scene, scene.absorption)[BAND_1KHZ] + 0.1
    assert f"which takes {decay_s:.1f} s at 1 kHz" in record.message


@pytest.mark.parametrize("fs_hz", [8000, 16000, 48000])
@pytest.mark.parametrize("dims_m", [(3.0, 2.6, 2.4), (6.0, 5.0, 3.0)])
def test_reflections_do_not_add_up_below_the_lowest_frequencies(dims_m, fs_hz):
    """All pulses of geometrical acoustics are positive: without a high-pass, they would raise rumble by 20 dB."""
    scene = Scene(Shoebox(dims_m), [Material("all", 0.1, 0.2)] * 6, fs_hz=fs_hz)
    spectra = []
    for seed in range(3):
        (response,) = simulate_responses(scene, *places(scene.room, 2, seed), num_rays=500, seed=seed)
        spectra.append(np.abs(np.fft.rfft(response.rir, 2 * fs_hz)) ** 2)

    def level_db(low_hz, high_hz):
        return 10.0 * np.log10(np.mean([spectrum[2 * low_hz:2 * high_hz].mean() for spectrum in spectra]))

    assert level_db(0, 10) < level_db(710, 1420)
    assert level_db(25, 50) > level_db(710, 1420) - 6.0
