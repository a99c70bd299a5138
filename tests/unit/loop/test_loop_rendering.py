"""Renderings are measured over the time of their recordings."""

from types import SimpleNamespace

import numpy as np
import pytest
from rirmaker import DIRECT, coloured_rir

from roomeq.core.constants import FS_HZ
from roomeq.loop.features import feature_slice, measure_features
from roomeq.loop.rendering import RawRir, measure_row, on_recording_time
from roomeq.sim.scene import Material, Scene, Shoebox

FLOOR = feature_slice("floor")
SCENE = Scene(Shoebox((5.0, 4.0, 3.0)), [Material("wall", (0.2,) * 8, (0.3,) * 8)] * 6)


def rendering_and_data(recording, rendering, *, tof_removed):
    """Return a rendering as the loop has it, and the data of its recording."""
    measured = measure_features(recording)
    place = SimpleNamespace(source_pos_m=(1.0, 1.0, 1.5), mic_pos_m=(4.0, 1.0, 1.5))
    data = SimpleNamespace(rows=[dict(id="a", tof_removed=tof_removed)], places=[place],
                           distance_m=np.array([DIRECT / FS_HZ * SCENE.air.speed_m_s]),
                           direct_sample=np.array([measured.direct_sample]), n_samples=np.array([measured.n_samples]),
                           white=measured.white[None], features=measured.values[None])
    return RawRir(rendering, SCENE, np.ones(8)), data


@pytest.mark.parametrize("hum, agrees", [(0.0, True), (0.02, False)])
def test_decay_that_the_recording_cuts_off_is_no_noise(hum, agrees):
    """Low octaves hardly decay within the recording, as an object that rings; the recording has white noise."""
    low = coloured_rir(2, time_s=20.0, length_s=4.0, eq_db=(0.0, 0.0, 0.0, -60.0, -60.0, -60.0, -60.0, -60.0))
    whole = low + np.pad(coloured_rir(1, time_s=0.3, length_s=1.0), (0, 3 * FS_HZ))
    time_s = np.arange(int(1.2 * FS_HZ)) / FS_HZ
    noise = 2e-4 * np.random.default_rng(3).standard_normal(len(time_s)) + hum * np.sin(2.0 * np.pi * 125.0 * time_s)
    raw, data = rendering_and_data(whole[:len(time_s)] + noise, whole, tof_removed=False)
    alone, as_recorded = measure_features(whole, DIRECT, white=data.white[0]), measure_row(data, 0, raw, [], 0)
    assert np.max(data.features[0, FLOOR] - alone.values[FLOOR]) > 6.0
    assert (np.max(data.features[0, FLOOR] - as_recorded.values[FLOOR]) < 3.0) == agrees
    others = np.delete(np.arange(len(alone.values)), FLOOR)
    np.testing.assert_array_equal(as_recorded.values[others], alone.values[others])


def test_slow_decay_that_the_recording_cuts_off_is_not_seen_as_noise():
    """Low octaves decay slowly, as in a room that absorbs only high ones."""
    low = coloured_rir(2, time_s=3.0, length_s=1.2, eq_db=(0.0, 0.0, 0.0, -60.0, -60.0, -60.0, -60.0, -60.0))
    recording = low + coloured_rir(1, time_s=0.3, length_s=1.2)
    recording += 2e-4 * np.random.default_rng(3).standard_normal(len(recording))
    valid = measure_features(recording).valid[FLOOR]
    assert not valid[:9].any() and valid[12:].all()


@pytest.mark.parametrize("n_ahead", [0, 500])
def test_end_of_the_recording_is_as_long_after_the_direct_sound(n_ahead):
    rir = coloured_rir(1, time_s=0.3, length_s=1.0)
    raw, data = rendering_and_data(np.concatenate([np.zeros(n_ahead), rir[:8000]]), rir, tof_removed=True)
    rendered, direct_sample, end = on_recording_time(data, 0, raw, raw.rir)
    assert end - direct_sample == pytest.approx(data.n_samples[0] - data.direct_sample[0], abs=1.0)
    assert direct_sample == pytest.approx(measure_features(rendered).direct_sample, abs=1.0)
    assert direct_sample >= data.direct_sample[0]
