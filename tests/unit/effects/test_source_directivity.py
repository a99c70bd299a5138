"""The directivity of a loudspeaker: the same gain however many directions are asked for."""

import numpy as np

from roomeq.effects.source_directivity import SourceDirectivity


def test_gain_of_many_rays_is_that_of_each():
    rng = np.random.default_rng(0)
    source = SourceDirectivity(0.12, 0.6, tuple(rng.normal(0.0, 2.0, 24)))
    cosine = rng.uniform(-1.0, 1.0, 20000)
    of_each = np.concatenate([source.on_paths(part) for part in np.split(cosine, 200)])
    np.testing.assert_allclose(source.on_paths(cosine), of_each, rtol=0.01)


def test_gain_on_the_axis_is_one():
    source = SourceDirectivity(0.2, 1.0, tuple(np.linspace(-3.0, 3.0, 24)))
    np.testing.assert_allclose(source.on_paths(np.array([1.0])), 1.0, rtol=1e-9)
