"""One state of the loop: the data, a model, what it renders, and its fit."""

from dataclasses import dataclass, replace

import numpy as np

from roomeq.effects.catalogue import CATALOGUE
from roomeq.loop.cells import HAS_GAIN, METRIC, N_CELLS
from roomeq.loop.fit import Fit, fit
from roomeq.loop.layout import Layout
from roomeq.loop.rendering import render_rows, rendered_cells

_ORDER = list(CATALOGUE.values())


@dataclass(frozen=True)
class Session:
    """A fitted model.

    Attributes
    ----------
    data : roomeq.loop.data.Data
    effects : tuple of types
        Of the model, in the catalogue's order, less those that the base model was given.
    offset : ndarray, shape (n_rirs, n_cells)
        What measuring adds to expected cells.
    fit : Fit
    by_row : list of list of Effect
        The effects of each RIR with their parameters.
    seed, nj : int
    """

    data: object
    effects: tuple
    offset: np.ndarray
    fit: Fit
    by_row: list
    seed: int
    nj: int

    @property
    def layout(self):
        return Layout(self.data, self.effects)

    @property
    def residual(self):
        """Measured less expected cells; NaN where one of the two is missing."""
        return np.where(self.data.valid, self.data.cells - self.fit.predicted, np.nan)


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


def begin(data, *, like=None, offset=None, seed, nj):
    """Fit a model, render it, and fit it again to what rendering showed.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    like : Fit, optional
        A first fit of the model, the base model's if not given.
    offset : ndarray, shape (n_rirs, n_cells), optional
        With which it was made.
    seed, nj : int

    Returns
    -------
    Session
    """
    if like is None:
        forget_shifts(data, data.given_kinds)
        offset = np.zeros((len(data.rows), N_CELLS))
        like = fit(data, offset, ())
    layout = Layout(data, like.effects)
    absorption, vectors = layout.absorption(like.mean, like.local), layout.vectors(like.mean, like.local)
    by_row = effects_of_rows(data, like.effects, vectors)
    raws = render_rows(data, absorption[data.room], by_row, seed=seed, nj=nj)
    rendered = rendered_cells(data, raws, by_row, seed=seed, nj=nj)
    gains = np.outer(layout.gains(like.local), HAS_GAIN)
    by_rays = _of_rays(data, raws, by_row, rendered, (layout, absorption, vectors, gains), seed, nj)
    for effect in _ORDER:
        if effect.NODES:
            data.shifts[effect.NAME] = _shifts(data, raws, by_row, rendered, by_rays, effect, seed, nj)
    expected = layout.predict(absorption, vectors, np.zeros(len(data.rows)), 0.0)
    mean, own, share = _offset(data, rendered - expected, data.cells - gains - expected)
    new = mean + share * own
    found = fit(data, new, like.effects, like=fit(data, new, like.effects, like=replace(like, by_surface=None)))
    vectors = layout.vectors(found.mean, found.local)
    return Session(data, like.effects, new, found, effects_of_rows(data, like.effects, vectors), seed, nj)


def forget_shifts(data, effects):
    """Let what effects change by rendering alone be unknown, and so in the offset."""
    for effect in effects:
        if effect.NODES:
            data.shifts[effect.NAME] = np.zeros((len(effect.NODES), *data.cells.shape))


def _of_rays(data, raws, by_row, rendered, fitted, seed, nj):
    """Without effects that rendering alone shows: what chance made of the cells, and what measured cells have more.

    Chance is what was rendered less what was expected, less what of that is none.
    """
    layout, absorption, vectors, gains = fitted
    with_nodes = tuple(effect for effect in layout.effects if effect.NODES)
    rays = [[one for one in effects if not isinstance(one, with_nodes)] for effects in by_row]
    cells = rendered if rays == by_row else rendered_cells(data, raws, rays, seed=seed, nj=nj)
    kept = [(effect, one) for effect, one in zip(layout.effects, vectors, strict=True) if effect not in with_nodes]
    expected = Layout(data, [effect for effect, _ in kept]).predict(
        absorption, [one for _, one in kept], np.zeros(len(data.rows)), 0.0)
    error = data.cells - gains - expected
    _, own, share = _offset(data, cells - expected, error)
    return (1.0 - share) * own, error


def _shifts(data, raws, by_row, rendered, by_rays, effect, seed, nj):
    """What an effect makes of the cells of the model's RIRs at each of its nodes, shape (n_nodes, n_rirs, n_cells).

    What takes the place of rays, such as a wave field, takes that of their chance too: as much of it goes as is not
    found again with the effect. Of what it does to one RIR and not to others, as much is kept as helps (`_offset`): a
    level at a mode is known, how two of them beat is not, when positions are known to centimetres.
    """
    chance, error = by_rays
    without = [[one for one in effects if not isinstance(one, effect)] for effects in by_row]
    plain = rendered if without == by_row else rendered_cells(data, raws, without, seed=seed, nj=nj)
    power, found = np.maximum(np.sum(chance ** 2, axis=0), 1e-9), []
    for node in effect.NODES:
        new = effect.from_vector(np.array(node))
        extended = [_sorted([*effects, new]) for effects in without]
        change = rendered_cells(data, raws, extended, seed=seed, nj=nj) - plain
        change = np.where(np.isfinite(change), change, 0.0)
        gone = np.clip(-np.sum((change - change.mean(axis=0)) * chance, axis=0) / power, 0.0, 1.0)
        mean, own, share = _offset(data, change + gone * chance, error)
        found.append(mean + share * own)
    return np.array(found)


def _offset(data, difference, error):
    """What measuring adds to expected cells: the mean over RIRs, each RIR's own, and how much of that helps.

    Early reflections are the same whenever they are rendered, noise-like tails are not: how much of an RIR's own
    offset means something is a regression on what was measured in the other rooms, one coefficient a metric.

    Parameters
    ----------
    difference : ndarray, shape (n_rirs, n_cells)
        Rendered less expected cells.
    error : ndarray, shape (n_rirs, n_cells)
        Measured less expected cells.

    Returns
    -------
    mean, own, share : ndarray, shape (n_cells,), (n_rirs, n_cells), (n_rirs, n_cells)
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
