"""What rendering a model shows and its tables cannot tell: what measuring adds, and what effects do to waves."""

from dataclasses import dataclass

import numpy as np

from roomeq.effects.catalogue import CATALOGUE
from roomeq.loop.features import HAS_GAIN, METRIC
from roomeq.loop.fit import Fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendering import features_with_effects, render_rows

_ORDER = list(CATALOGUE.values())


@dataclass(frozen=True)
class RenderedModel:
    """A rendered model.

    Attributes
    ----------
    data : roomeq.loop.data.Data
    fit : Fit
        Whose unknowns were rendered.
    by_row : list of list of Effect
        The effects of each RIR.
    raws : list of roomeq.loop.rendering.Raw
    features : ndarray, shape (n_rirs, n_features)
    seed, nj : int
    """

    data: object
    fit: Fit
    by_row: list
    raws: list
    features: np.ndarray
    seed: int
    nj: int

    def features_with(self, by_row):
        """Features with other effects behind the rendering."""
        return self.features if by_row == self.by_row else self.features_of([by_row])[0]

    def features_of(self, variants):
        """The same of several variants, shape (n_variants, n_rirs, n_features)."""
        return features_with_effects(self.data, self.raws, variants, seed=self.seed, nj=self.nj)

    def predicted_without(self, effects=()):
        """Features that tables expect of the model without some effects: of what is rendered, and of what is measured."""
        packing, one = ParameterIndex(self.data, self.fit.effects), self.fit
        absorption, vectors = packing.absorption(one.mean, one.local), packing.vectors(one.mean, one.local)
        kept = [(effect, vector) for effect, vector in zip(packing.effects, vectors, strict=True)
                if effect not in effects]
        expected = ParameterIndex(self.data, [effect for effect, _ in kept]).predict(
            absorption, [vector for _, vector in kept], np.zeros(len(self.data.rows)), 0.0)
        return expected, expected + np.outer(packing.gains(one.local), HAS_GAIN)


def render_model(data, fitted, *, seed, nj):
    """Render a fitted model."""
    packing = ParameterIndex(data, fitted.effects)
    absorption, vectors = packing.absorption(fitted.mean, fitted.local), packing.vectors(fitted.mean, fitted.local)
    by_row = effects_of_rows(data, fitted.effects, vectors)
    raws, features = render_rows(data, absorption[data.room], by_row, seed=seed, nj=nj)
    return RenderedModel(data, fitted, by_row, raws, features, seed, nj)


def in_order(effects):
    """Types of effects in the catalogue's order."""
    return tuple(sorted(effects, key=_ORDER.index))


def effects_of_rows(data, effects, vectors):
    """The effects of each RIR, from the vectors of their units, and those that the base model was given."""
    units = [[effect.from_vector(vector) for vector in one] for effect, one in zip(effects, vectors, strict=True)]
    numbers = [data.units(effect.SCOPE)[1] for effect in effects]
    return [_sorted([*data.given[n], *(units[k][numbers[k][n]] for k in range(len(effects)))])
            for n in range(len(data.rows))]


def _sorted(effects):
    return sorted(effects, key=lambda one: _ORDER.index(type(one)))


def rendering_correction(rendered):
    """What measuring adds to expected features, shape (n_rirs, n_features): all of its mean, of each RIR's own what helps."""
    expected, measured = rendered.predicted_without()
    mean, own, share = _parts(rendered.data, rendered.features - expected, rendered.data.features - measured)
    return mean + share * own


def clear_rendered_changes(data, effects):
    """Let what effects change by rendering alone be unknown, and so in the correction."""
    for effect in effects:
        if effect.INTERPOLATION_GRID:
            data.rendered_changes[effect.NAME] = np.zeros((len(effect.INTERPOLATION_GRID), *data.features.shape))


def measure_rendered_changes(rendered, effects):
    """Measure on renderings what effects change at each point of their grid (`Data.rendered_change_of`)."""
    effects = [effect for effect in effects if effect.INTERPOLATION_GRID]
    if effects:
        by_rays = _by_rays(rendered)
        for effect in effects:
            rendered.data.rendered_changes[effect.NAME] = _rendered_changes(rendered, by_rays, effect)


def _by_rays(rendered):
    """Without effects that rendering alone shows: what chance made of the features, and what measured features have more.

    Chance is what was rendered less what was expected, less what of that is none.
    """
    waves = tuple(effect for effect in rendered.fit.effects if effect.INTERPOLATION_GRID)
    features = rendered.features_with([[one for one in effects if not isinstance(one, waves)] for effects in rendered.by_row])
    expected, measured = rendered.predicted_without(waves)
    error = rendered.data.features - measured
    _, own, share = _parts(rendered.data, features - expected, error)
    return (1.0 - share) * own, error


def _rendered_changes(rendered, by_rays, effect):
    """What an effect makes of the features of the model's RIRs at each of its nodes, shape (n_nodes, n_rirs, n_features).

    What takes the place of rays, such as a wave field, takes that of their chance too: as much of it goes as is not
    found again with the effect. Of what it does to one RIR and not to others, as much is kept as helps (`_parts`): a
    level at a mode is known, how two of them beat is not, when positions are known to centimetres.
    """
    chance, error = by_rays
    without = [[one for one in effects if not isinstance(one, effect)] for effects in rendered.by_row]
    plain = rendered.features_with(without)
    new = [effect.from_vector(np.array(node)) for node in effect.INTERPOLATION_GRID]
    power, found = np.maximum(np.sum(chance ** 2, axis=0), 1e-9), []
    for features in rendered.features_of([[_sorted([*effects, one]) for effects in without] for one in new]):
        change = features - plain
        change = np.where(np.isfinite(change), change, 0.0)
        gone = np.clip(-np.sum((change - change.mean(axis=0)) * chance, axis=0) / power, 0.0, 1.0)
        mean, own, share = _parts(rendered.data, change + gone * chance, error)
        found.append(mean + share * own)
    return np.array(found)


def _parts(data, difference, error):
    """What is added to expected features: the mean over RIRs, each RIR's own, and how much of that helps.

    Early reflections are the same whenever they are rendered, noise-like tails are not: how much of what is
    an RIR's own means something is a regression on what was measured in the other rooms, one coefficient a metric.

    Parameters
    ----------
    difference : ndarray, shape (n_rirs, n_features)
        What is added, such as rendered less expected features.
    error : ndarray, shape (n_rirs, n_features)
        Measured less expected features.

    Returns
    -------
    mean, own, share : ndarray, shape (n_features,), (n_rirs, n_features), (n_rirs, n_features)
    """
    seen = np.isfinite(difference)
    mean = np.sum(np.where(seen, difference, 0.0), axis=0) / np.maximum(seen.sum(axis=0), 1)
    own = np.where(seen, difference - mean, 0.0)
    valid = data.valid & np.isfinite(error)
    centred = np.where(valid, error, 0.0)
    centred = np.where(valid, error - centred.sum(axis=0) / np.maximum(valid.sum(axis=0), 1), 0.0)
    share = np.zeros(own.shape)
    for metric in np.unique(METRIC):
        at = METRIC == metric
        power, both = (np.bincount(data.room, np.sum(np.where(valid, own * one, 0.0)[:, at], axis=1))
                       for one in (own, centred))
        share[:, at] = np.clip((both.sum() - both) / np.maximum(power.sum() - power, 1e-9), 0.0, 1.0)[data.room, None]
    return mean, own, share
