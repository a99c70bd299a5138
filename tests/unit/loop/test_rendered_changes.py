"""Changes that effects make to rendered features: at which points of their grid they are measured."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.effects.room_modes import RoomModes
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import rendered_model


@pytest.mark.parametrize(("effects", "known", "points"), [
    ((SourceResponse,), True, [0, 1, 2, 3, 4]),
    ((SourceResponse, RoomModes), False, [0, 1, 2, 3, 4]),
    ((SourceResponse, RoomModes), True, [1, 2])])
def test_an_effect_of_the_model_is_measured_again_next_to_its_parameters(effects, known, points, monkeypatch):
    vectors = [np.zeros((1, 8)), np.log2([[70.0 / 100.0]])]
    monkeypatch.setattr(rendered_model, "ParameterIndex", lambda _, of_fit: SimpleNamespace(
        effects=of_fit, vectors=lambda *_: vectors[:len(of_fit)]))
    rendered = SimpleNamespace(data=SimpleNamespace(rendered_changes={RoomModes.NAME: None} if known else {}),
                               fit=SimpleNamespace(effects=effects, mean=None, local=None))
    np.testing.assert_array_equal(rendered_model._points_to_measure(rendered, RoomModes), points)
