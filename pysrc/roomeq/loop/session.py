"""One state of the loop: the data, a model, what it renders, and its fit."""

from dataclasses import dataclass, replace

import numpy as np

from roomeq.loop.features import N_FEATURES
from roomeq.loop.fit import Fit, fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendered_model import (
    clear_rendered_changes,
    effects_of_rows,
    measure_rendered_changes,
    render_model,
    rendering_correction,
)


@dataclass(frozen=True)
class Session:
    """A fitted model.

    Attributes
    ----------
    data : roomeq.loop.data.Data
    effects : tuple of types
        Of the model, in the catalogue's order, less those that the base model was given.
    correction : ndarray, shape (n_rirs, n_features)
        What measuring adds to expected features.
    fit : Fit
    seed, nj : int
    """

    data: object
    effects: tuple
    correction: np.ndarray
    fit: Fit
    seed: int
    nj: int

    @property
    def packing(self):
        return ParameterIndex(self.data, self.effects)

    @property
    def by_row(self):
        """The effects of each RIR with their parameters, list of list of Effect."""
        return effects_of_rows(self.data, self.effects, self.packing.vectors(self.fit.mean, self.fit.local))

    @property
    def residual(self):
        """Measured less expected features; NaN where one of the two is missing."""
        residual, counts = self.data.residual(self.fit.predicted)
        return np.where(counts, residual, np.nan)


def begin(data, *, like=None, correction=None, seed, nj):
    """Fit a model, render it, and fit it again to what rendering showed.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    like : Fit, optional
        A first fit of the model, the base model's if not given.
    correction : ndarray, shape (n_rirs, n_features), optional
        With which it was made.
    seed, nj : int

    Returns
    -------
    Session
    """
    if like is None:
        clear_rendered_changes(data, data.given_kinds)
        correction = np.zeros((len(data.rows), N_FEATURES))
        like = fit(data, correction, ())
    rendered = render_model(data, like, seed=seed, nj=nj)
    measure_rendered_changes(rendered, like.effects)
    correction = rendering_correction(rendered)
    first = fit(data, correction, like.effects, like=replace(like, by_surface=None))
    found = fit(data, correction, like.effects, like=first)
    return Session(data, like.effects, correction, found, seed, nj)


def look_ahead(session, candidates):
    """Find what candidates change by rendering alone."""
    if any(effect.INTERPOLATION_GRID for effect in candidates):
        measure_rendered_changes(render_model(session.data, session.fit, seed=session.seed, nj=session.nj), candidates)
