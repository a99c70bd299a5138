"""A fitted model together with its data and its rendering correction."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.loop.data import Data
from roomeq.loop.features import N_FEATURES
from roomeq.loop.fit import Fit, fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendered_model import (
    clear_rendered_changes,
    effects_of_rows,
    in_order,
    measure_rendered_changes,
    render_model,
    rendered_difference,
)


@dataclass(frozen=True)
class Session:
    """A fitted model.

    Attributes
    ----------
    data : Data
    effects : tuple of types
        Effects that the loop has added, in the catalogue's order; those of the base model are in `Data.given`.
    correction : ndarray, shape (n_rirs, n_features)
        What is added to features predicted from tables when the model is fitted: the helpful part of `difference`.
    difference : ndarray, shape (n_rirs, n_features)
        Features measured on rendered RIRs minus features predicted from tables, NaN where there was nothing to measure.
    fit : Fit
    seed, nj : int
    """

    data: Data
    effects: tuple[type[Effect], ...]
    correction: FloatArray
    difference: FloatArray
    fit: Fit
    seed: int
    nj: int

    @property
    def index(self) -> ParameterIndex:
        return ParameterIndex(self.data, self.effects)

    @property
    def by_row(self) -> list[list[Effect]]:
        """The effects of each RIR with their parameters."""
        return effects_of_rows(self.data, self.effects, self.index.vectors(self.fit.mean, self.fit.local))

    @property
    def residual(self) -> FloatArray:
        """Measured minus predicted features, shape (n_rirs, n_features); NaN where one of the two is missing."""
        residual, valid = self.data.residual(self.fit.predicted)
        return np.where(valid, residual, np.nan)


def fit_base_model(data: Data, *, seed: int, nj: int, measured: Iterable[type[Effect]] = ()) -> Session:
    """Fit the base model, render it, and fit it again with the rendering correction.

    For `measured` see `refit_rendered`.
    """
    data = clear_rendered_changes(data, data.given_kinds)
    correction = np.zeros((len(data.rows), N_FEATURES))
    return refit_rendered(data, fit(data, correction, ()), seed=seed, nj=nj, measured=measured)


def refit_rendered(data: Data, fitted: Fit, *, seed: int, nj: int, measured: Iterable[type[Effect]] = ()) -> Session:
    """Render a fitted model, and fit it again with the rendering correction.

    What the effects `measured` change when they are rendered, whether the model has them or not, is measured first. Of
    its other effects it is known from another model, as other effects hardly change it.
    """
    rendered = render_model(data, fitted, seed=seed, nj=nj)
    data = measure_rendered_changes(rendered, measured)
    whole, correction = rendered_difference(replace(rendered, data=data))
    first = fit(data, correction, fitted.effects, initial=fitted)
    of_surfaces = first.derivatives._replace(by_effect={})  # which are smoother than those of effects
    final = fit(data, correction, fitted.effects, initial=first, known=of_surfaces)
    return Session(data, fitted.effects, correction, whole, final, seed, nj)


def refit(session: Session, initial: Fit, effects: Sequence[type[Effect]] | None = None) -> Session:
    """Return a session with another model, fitted from `initial` with the rendering correction of the session's model.

    It has the `effects`, by default those of `initial`. Nothing is rendered.
    """
    fitted = fit(session.data, session.correction, in_order(initial.effects if effects is None else effects),
                 initial=initial, known=session.fit.derivatives)
    return replace(session, effects=fitted.effects, fit=fitted)


def effects_lacking(data: Data, known: Collection[type[Effect]] = ()) -> list[type[Effect]]:
    """Return the effects that apply to data, but for those that are `known` or given."""
    return [effect for effect in CATALOGUE.values()
            if effect not in {*known, *data.given_kinds} and effect.applies(data)]


def with_measured_effects(session: Session) -> Session:
    """Return a session whose model also has what is read off any recording, such as its noise (`Effect.MEASURED`)."""
    lacking = [effect for effect in effects_lacking(session.data, session.effects) if effect.MEASURED]
    return refit(session, session.fit, [*session.effects, *lacking]) if lacking else session
