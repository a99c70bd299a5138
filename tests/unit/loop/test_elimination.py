"""Effects that a newer one makes superfluous."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.effects.noise_floor import NoiseFloor
from roomeq.effects.occlusion import Occlusion
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import close
from roomeq.loop.features import N_FEATURES
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors
from roomeq.loop.ledger import added_effects, update_errors
from roomeq.loop.session import Session

ROOMS = 8


def errors(jnd, seed=0):
    """Return errors of rooms of two RIRs that scatter a little."""
    rng = np.random.default_rng(seed)
    values = jnd + 0.05 * rng.standard_normal((2 * ROOMS, 1)) * np.ones(N_FEATURES)
    return HeldOutErrors(dict.fromkeys(SPLITS, values), np.repeat(np.arange(ROOMS), 2), np.tile([0, 1], ROOMS))


def session_with(effects):
    return Session(None, tuple(effects), None, None, SimpleNamespace(effects=tuple(effects)), 0, 1)


@pytest.mark.parametrize(("without", "superfluous"), [
    ({SourceResponse: 2.0, Occlusion: 2.4}, [SourceResponse]),
    ({SourceResponse: 2.4, Occlusion: 2.4}, []),
    ({SourceResponse: 1.9, Occlusion: 2.0}, [Occlusion, SourceResponse])])
def test_effect_is_superfluous_if_the_error_does_not_rise_without_it(without, superfluous, monkeypatch):
    every = (Occlusion, SourceDirectivity, SourceResponse)
    fitted = session_with(every)
    tried, rendered = [], []

    def error_without(session):
        tried.append([effect for effect in every if effect not in session.effects])
        return errors(without[tried[-1][-1]] if tried[-1] else 2.0, seed=len(tried))

    def rendered_error_without(session):
        rendered.append(session.effects)
        return error_without(session)

    monkeypatch.setattr(close, "refit", lambda session, _, effects: session_with(effects))
    monkeypatch.setattr(close, "refit_rendered", lambda data, fit, **_: session_with(fit.effects))
    monkeypatch.setattr(close, "predicted_errors", error_without)
    monkeypatch.setattr(close, "heldout_errors", rendered_error_without)
    monkeypatch.setattr(close, "weights_of", lambda *_: np.ones((2 * ROOMS, N_FEATURES), dtype=bool))
    session, left, found = close._eliminate(fitted, errors(2.0, seed=9), lambda: error_without(fitted),
                                            SourceDirectivity)
    assert set(session.effects) == set(every) - set(superfluous)
    assert found == superfluous
    assert left.mean(SPLITS[0]) == pytest.approx(without[superfluous[-1]] if superfluous else 2.0, abs=0.1)
    assert not any(SourceDirectivity in effects for effects in tried)
    assert len(rendered) == len(superfluous)  # the prediction tells that the others are needed


def test_effect_stays_if_only_the_prediction_can_do_without_it(monkeypatch):
    fitted, of_fitted = session_with((SourceResponse, SourceDirectivity)), errors(2.0, seed=9)
    monkeypatch.setattr(close, "refit", lambda session, _, effects: session_with(effects))
    monkeypatch.setattr(close, "refit_rendered", lambda data, fit, **_: session_with(fit.effects))
    monkeypatch.setattr(close, "predicted_errors", lambda session: errors(2.0, seed=len(session.effects)))
    monkeypatch.setattr(close, "heldout_errors", lambda session: errors(2.4))
    monkeypatch.setattr(close, "weights_of", lambda *_: np.ones((2 * ROOMS, N_FEATURES), dtype=bool))
    assert close._eliminate(fitted, of_fitted, lambda: of_fitted, SourceDirectivity) == (fitted, of_fitted, [])


def test_noise_of_the_recordings_is_not_superfluous(monkeypatch):
    fitted = session_with((SourceDirectivity, NoiseFloor))
    monkeypatch.setattr(close, "refit", lambda *_, **__: pytest.fail("a model without the noise was tried"))
    session, _, found = close._eliminate(fitted, errors(2.0), lambda: errors(2.0), SourceDirectivity)
    assert session is fitted and found == []


def test_eliminated_effects_are_not_among_the_added_ones():
    entries = [dict(effect="source_response", scored_on=SPLITS[0]), dict(effect="source_directivity",
               scored_on=SPLITS[0], by_metric=dict(before={}, after={}), by_band=dict(before=[], after=[]))]
    update_errors(entries[1], errors(2.0, seed=1), errors(1.5), ["source_response"])
    assert [entry["effect"] for entry in added_effects(dict(iterations=entries))] == ["source_directivity"]
    assert entries[1]["heldout_error_after"] == pytest.approx(1.5, abs=0.1)
    low, high = entries[1]["heldout_error_ci"]
    assert low < entries[1]["heldout_error_after"] < high
    low, high = entries[1]["fall_ci"]
    assert 0.3 < low < 0.5 < high < 0.7
