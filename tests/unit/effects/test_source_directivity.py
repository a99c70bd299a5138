"""The directivity of a loudspeaker: the same gain however many directions are asked for."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.loop.tables import ANGLES


def test_gain_of_many_rays_is_that_of_each():
    rng = np.random.default_rng(0)
    source = SourceDirectivity(0.12, 0.6, tuple(rng.normal(0.0, 2.0, 24)))
    cosine = rng.uniform(-1.0, 1.0, 20000)
    of_each = np.concatenate([source.on_paths(part) for part in np.split(cosine, 200)])
    np.testing.assert_allclose(source.on_paths(cosine), of_each, rtol=0.01)


def test_gain_on_the_axis_is_one():
    source = SourceDirectivity(0.2, 1.0, tuple(np.linspace(-3.0, 3.0, 24)))
    np.testing.assert_allclose(source.on_paths(np.array([1.0])), 1.0, rtol=1e-9)


@pytest.mark.parametrize("radius_m, cap_rad", [(0.03, 0.5), (0.2, 0.5), (0.2, 0.8)])
def test_predicted_gain_of_a_diffuse_field_is_the_mean_over_the_sphere(radius_m, cap_rad):
    """Lobes of a large membrane are narrower than the grid of angles."""
    source, rng = SourceDirectivity(radius_m, cap_rad), np.random.default_rng(0)
    angle = np.arccos(rng.uniform(-1.0, 1.0, 200_000))  # of rays, whose energy is shared out to two angles each
    shares = [np.interp(angle, ANGLES, node).mean() for node in np.eye(len(ANGLES))]
    state = SimpleNamespace(direct_angle=np.zeros(1), apply_directivity=lambda *given: gains.append(given[1]))
    gains = []
    data = SimpleNamespace(angles=ANGLES, tables=[SimpleNamespace(angular=1)])
    source.apply_to_prediction(state, data, np.array([0]))
    exact = source.on_paths(np.cos(angle)).mean(axis=0)
    np.testing.assert_allclose(10.0 * np.log10(shares @ gains[0] / exact), 0.0, atol=0.1)
