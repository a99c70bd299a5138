"""A rendered model, and what its renderings add to the prediction from tables.

Renderings tell two things that tables of ray contributions cannot: the bias and the interference that windows, filters
and early reflections bring into the features (`rendered_difference`), and the change of the features by effects that
act on waves (`measure_rendered_changes`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.loop.data import Data
from roomeq.loop.features import HAS_GAIN, METRIC
from roomeq.loop.fit import Fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendering import RawRir, features_with_effects, render_rows, row_models

_ORDER = list(CATALOGUE.values())


@dataclass(frozen=True)
class RenderedModel:
    """A rendered model.

    Attributes
    ----------
    data : roomeq.loop.data.Data
    fit : Fit
        The fit that was rendered.
    by_row : list of list of Effect
        The effects of each RIR.
    raw_rirs : list of roomeq.loop.rendering.RawRir
    features : ndarray, shape (n_rirs, n_features)
    seed, nj : int
    """

    data: Data
    fit: Fit
    by_row: list[list[Effect]]
    raw_rirs: list[RawRir]
    features: FloatArray
    seed: int
    nj: int

    def features_with(self, by_row: list[list[Effect]]) -> FloatArray:
        """Measure the features with other effects on the rendered RIRs, shape (n_rirs, n_features)."""
        return self.features if by_row == self.by_row else self.features_of([by_row])[0]

    def features_of(self, variants: Sequence[list[list[Effect]]]) -> FloatArray:
        """Measure the same of several variants, shape (n_variants, n_rirs, n_features)."""
        return features_with_effects(self.data, self.raw_rirs, variants, seed=self.seed, nj=self.nj)

    @property
    def recorded_gains(self) -> FloatArray:
        """Gains that features of the recordings have and those of the rendered RIRs have not, (n_rirs, n_features)."""
        return np.outer(ParameterIndex(self.data, self.fit.effects).gains(self.fit.local), HAS_GAIN)


class _Difference(NamedTuple):
    """Parts of a difference between features."""

    mean: FloatArray
    """Over RIRs, shape (n_features,)."""
    own: FloatArray
    """Each RIR's deviation from the mean, shape (n_rirs, n_features)."""
    share: FloatArray
    """How much of the deviation helps to predict the recordings, in [0, 1], shape (n_rirs, n_features)."""

    @property
    def helpful(self) -> FloatArray:
        """The mean and the helpful share of the deviations, shape (n_rirs, n_features)."""
        return self.mean + self.share * self.own


class _RayField(NamedTuple):
    """The model's features without effects that act on waves, shape (n_rirs, n_features) each."""

    features: FloatArray
    """As rendered."""
    monte_carlo_noise: FloatArray
    """Their part that is due to random rays and tails."""
    error: FloatArray
    """Measured less predicted features."""


def render_model(data: Data, fitted: Fit, *, seed: int, nj: int) -> RenderedModel:
    """Render a fitted model."""
    packing = ParameterIndex(data, fitted.effects)
    absorption, vectors = packing.absorption(fitted.mean, fitted.local), packing.vectors(fitted.mean, fitted.local)
    by_row = effects_of_rows(data, fitted.effects, vectors)
    raw_rirs, features = render_rows(data, row_models(data, absorption, by_row), seed=seed, nj=nj)
    return RenderedModel(data, fitted, by_row, raw_rirs, features, seed, nj)


def predicted_without(data: Data, fitted: Fit, effects: Sequence[type[Effect]] = ()) -> FloatArray:
    """Predict the features of a fitted model without some of its effects and without gains, (n_rirs, n_features)."""
    index = ParameterIndex(data, fitted.effects)
    vectors = index.vectors(fitted.mean, fitted.local)
    kept = [k for k, effect in enumerate(index.effects) if effect not in effects]
    return ParameterIndex(data, [index.effects[k] for k in kept]).predict(
        index.absorption(fitted.mean, fitted.local), [vectors[k] for k in kept])


def change_by(data: Data, effect: type[Effect], fitted: Fit) -> FloatArray:
    """Return the predicted change of the features by an effect of a fitted model, (n_rirs, n_features) [JND]."""
    change = predicted_without(data, fitted) - predicted_without(data, fitted, [effect])
    return np.where(data.valid, change, 0.0)


def in_order(effects: Iterable[type[Effect]]) -> tuple[type[Effect], ...]:
    """Return types of effects in the catalogue's order."""
    return tuple(sorted(effects, key=_ORDER.index))


def effects_of_rows(data: Data, effects: Sequence[type[Effect]], vectors: Sequence[FloatArray]) -> list[list[Effect]]:
    """Return the effects of each RIR: those with the vectors of their units, and those of the base model.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    effects : sequence of types
    vectors : sequence of ndarray, shape (n_units, n)
        For each effect, the vectors of its units.
    """
    units = [[effect.from_vector(vector) for vector in of_effect]
             for effect, of_effect in zip(effects, vectors, strict=True)]
    numbers = [data.units(effect.SCOPE)[1] for effect in effects]
    return [_sorted([*data.given[n], *(units[k][numbers[k][n]] for k in range(len(effects)))])
            for n in range(len(data.rows))]


def _sorted(effects: Iterable[Effect]) -> list[Effect]:
    return sorted(effects, key=lambda effect: _ORDER.index(type(effect)))


class RenderedDifference(NamedTuple):
    """Features measured on rendered RIRs less those predicted from tables, (n_rirs, n_features) each."""

    whole: FloatArray
    """NaN where there is nothing to measure."""
    helpful: FloatArray
    """The mean over RIRs, and of each RIR's own difference as much as helps to predict the recordings."""


def rendered_difference(rendered: RenderedModel) -> RenderedDifference:
    """Compare a rendered model with its prediction from tables."""
    predicted = predicted_without(rendered.data, rendered.fit)
    whole = rendered.features - predicted
    return RenderedDifference(whole, _split(rendered.data, whole, rendered.data.features
                                            - (predicted + rendered.recorded_gains)).helpful)


def clear_rendered_changes(data: Data, effects: Iterable[type[Effect]]) -> Data:
    """Return data whose rendered changes of some effects are 0; the rendering correction then includes them."""
    zeros = {effect.NAME: np.zeros((len(effect.INTERPOLATION_GRID), *data.features.shape))
             for effect in effects if effect.INTERPOLATION_GRID}
    return replace(data, rendered_changes={**data.rendered_changes, **zeros})


def measure_rendered_changes(rendered: RenderedModel, effects: Iterable[type[Effect]]) -> Data:
    """Return data with the changes that effects make to rendered features, at each point of their grid."""
    effects = [effect for effect in effects if effect.INTERPOLATION_GRID]
    if not effects:
        return rendered.data
    ray_field = _ray_field(rendered)
    changes = {effect.NAME: _rendered_changes(rendered, ray_field, effect) for effect in effects}
    return replace(rendered.data, rendered_changes={**rendered.data.rendered_changes, **changes})


def _ray_field(rendered: RenderedModel) -> _RayField:
    """Compare rendering, prediction and recordings without the effects that act on waves."""
    on_waves = tuple(effect for effect in rendered.fit.effects if effect.INTERPOLATION_GRID)
    features = rendered.features_with([[effect for effect in effects if not isinstance(effect, on_waves)]
                                       for effects in rendered.by_row])
    predicted = predicted_without(rendered.data, rendered.fit, on_waves)
    error = rendered.data.features - (predicted + rendered.recorded_gains)
    difference = _split(rendered.data, features - predicted, error)
    return _RayField(features, (1.0 - difference.share) * difference.own, error)


def _rendered_changes(rendered: RenderedModel, ray_field: _RayField, effect: type[Effect]) -> FloatArray:
    """Return the change of the features by an effect at each point of its grid, (n_points, n_rirs, n_features).

    It is measured at all points; or, of an effect of the model, whose change a smaller model has measured, at those
    next to its parameters.

    A wave field that replaces rays also replaces their Monte Carlo noise: the part of the noise that does not recur
    with the effect is taken back. Of the changes that differ between RIRs, the helpful share is kept (`_split`): the
    level at a mode is predictable, the beating of two modes is not where positions are known to centimetres.
    """
    noise, error = ray_field.monte_carlo_noise, ray_field.error
    without = [[existing for existing in effects if not isinstance(existing, effect)] for effects in rendered.by_row]
    alone = not any(kind.INTERPOLATION_GRID for kind in rendered.fit.effects if kind is not effect)
    plain = ray_field.features if alone else rendered.features_with(without)
    noise_power, n_points = np.maximum(np.sum(noise ** 2, axis=0), 1e-9), len(effect.INTERPOLATION_GRID)
    known = rendered.data.rendered_changes.get(effect.NAME)
    changes = np.empty((n_points, *plain.shape)) if known is None else known.copy()
    points = _points_to_measure(rendered, effect)
    grid = [effect.from_vector(np.array(effect.INTERPOLATION_GRID[point])) for point in points]
    for point, features in zip(points, rendered.features_of([[_sorted([*effects, new]) for effects in without]
                                                             for new in grid]), strict=True):
        change = features - plain
        change = np.where(np.isfinite(change), change, 0.0)
        removed = np.clip(-np.sum((change - change.mean(axis=0)) * noise, axis=0) / noise_power, 0.0, 1.0)
        changes[point] = _split(rendered.data, change + removed * noise, error).helpful
    return changes


def _points_to_measure(rendered: RenderedModel, effect: type[Effect]) -> IntArray:
    """Return the numbers of the points of an effect's grid at which its change is to be measured."""
    grid = np.array(effect.INTERPOLATION_GRID)
    if effect not in rendered.fit.effects or effect.NAME not in rendered.data.rendered_changes:
        return np.arange(len(grid))
    index = ParameterIndex(rendered.data, rendered.fit.effects)
    vectors = index.vectors(rendered.fit.mean, rendered.fit.local)[index.effects.index(effect)]
    distance = np.linalg.norm(grid - vectors[:, None], axis=2)
    return np.unique(np.argsort(distance, axis=1)[:, :2])


def _split(data: Data, difference: FloatArray, error: FloatArray) -> _Difference:
    """Split a difference into its mean over RIRs and the deviation of each RIR, of which a share helps.

    Only RIRs in which the feature is valid count: the direct sound of a rendering may be another than that of the
    recording, where an obstacle hides it. Early reflections are the same in every rendering, noise-like tails are not.
    The helpful share is a regression of the error of the prediction on the deviations in the other rooms, one
    coefficient per metric.

    Parameters
    ----------
    difference : ndarray, shape (n_rirs, n_features)
        For example rendered less predicted features.
    error : ndarray, shape (n_rirs, n_features)
        Measured less predicted features.
    """
    seen = np.isfinite(difference) & data.valid
    mean = np.sum(np.where(seen, difference, 0.0), axis=0) / np.maximum(seen.sum(axis=0), 1)
    own = np.where(seen, difference - mean, 0.0)
    valid = data.valid & np.isfinite(error)
    centred = np.where(valid, error, 0.0)
    centred = np.where(valid, error - centred.sum(axis=0) / np.maximum(valid.sum(axis=0), 1), 0.0)
    share = np.zeros(own.shape)
    for metric in np.unique(METRIC):
        at = METRIC == metric
        power, product = (np.bincount(data.room, np.sum(np.where(valid, own * factor, 0.0)[:, at], axis=1))
                          for factor in (own, centred))
        share[:, at] = np.clip((product.sum() - product) / np.maximum(power.sum() - power, 1e-9),
                               0.0, 1.0)[data.room, None]
    return _Difference(mean, own, share)
