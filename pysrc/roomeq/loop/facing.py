"""Where loudspeakers face, if nobody wrote it down: towards the microphone, or in a direction of their own.

The direct sound tells. A loudspeaker that faces the microphone sends its direct sound with the gain of its axis; one
that faces elsewhere sends less of it, above all at high frequencies, while its reflections stay. Of the direct sound,
only the features of `roomeq.loop.features.CALIBRATION_FEATURES` take part, which are never scored. Of the reflections,
the median over all RIRs of a source takes part, the scored ones among them: it takes out the source's response.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy.special import logsumexp

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.groups import numbers_by
from roomeq.core.workers import share_out
from roomeq.effects.prediction import PredictionState
from roomeq.effects.source_directivity import SourceDirectivity, unit_facing
from roomeq.loop.data import Data
from roomeq.loop.facing_estimate import FacingEstimate, Hypothesis
from roomeq.loop.features import BAND_OF_FEATURE, CALIBRATION_FEATURES, METRIC
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.predict import ReflectedEnergy, predict
from roomeq.loop.ray_energy import same
from roomeq.loop.session import Session
from roomeq.loop.tables import OF_SPHERE, turned
from roomeq.loop.traces import StoredArray
from roomeq.records.schema import unit_name
from roomeq.sim.geometry import towards_microphone

_AXES = np.array([(np.cos(azimuth), np.sin(azimuth), 0.0) for azimuth in np.radians(np.arange(0.0, 360.0, 5.0))])
"""Horizontal directions that are compared."""
_TEST_ANGLES = np.linspace(0.0, np.pi, 25)
_INDEPENDENT = 3.0  # of the third octaves of a direct sound, which err together
_SCALES = (1.0, 0.5, 0.25)
"""Of the scatter of the direct sound: without its directivity, a model takes what the source lacks for scatter."""
_DECISIVE = 1.0  # natural logarithm of the Bayes factor that other directions than the microphone's need


def unknown_facings(data: Data) -> IntArray:
    """Return the RIRs whose source faces nobody knows where."""
    return np.flatnonzero([unit_facing(row.get("source_dir")) is None for row in data.rows])


def with_estimated_facings(session: Session, unknown: IntArray | None = None) -> Session:
    """Return a session whose sources all face somewhere (`Data.facings`).

    Parameters
    ----------
    session : Session
    unknown : ndarray of int, optional
        RIRs whose facing is estimated, by default all without one.
    """
    fitted = session.fit
    data = session.data if unknown is None else without_facings(session.data, unknown)
    return replace(session, data=estimate_facings(data, session.index, fitted.mean, fitted.local, session.residual,
                                                  np.hypot(fitted.sigma, fitted.omega), nj=session.nj))


def without_facings(data: Data, rirs: IntArray) -> Data:
    """Return data in which the facing of some RIRs is unknown."""
    return replace(data, rows=[{**row, "source_dir": None} if n in rirs else row for n, row in enumerate(data.rows)])


def estimate_facings(data: Data, index: ParameterIndex, mean: FloatArray, local: list[FloatArray],
                     residual: FloatArray, spread: FloatArray, *, nj: int = 1) -> Data:
    """Return data with an estimate of each unknown facing.

    The directivity of a source is unknown as well: it is one of cabinets of several sizes, that of the base model if it
    has one, or none.

    Parameters
    ----------
    data : Data
    index : ParameterIndex
    mean, local
        Parameters of a model of the data.
    residual : ndarray, shape (n_rirs, n_features)
        Measured minus predicted features; NaN where invalid.
    spread : ndarray, shape (n_features,)
        Scatter of the features [JND].
    nj : int
        Number of processes; the result does not depend on it.
    """
    unknown = unknown_facings(data)
    if not len(unknown):
        return data
    log_likelihood, log_alike = _log_likelihood(data, index, mean, local, residual, spread, nj)
    # RIRs that share a direct sound, which errs alike in all of them, tell as much as one
    position, direct_sound = ([key(data, n) for n in range(len(data.rows))] for key in (_position, _direct_sound))
    share = np.empty(len(data.rows))
    for sharing in numbers_by(direct_sound).values():
        share[sharing] = 1.0 / len(sharing)
    log_likelihood, log_alike = log_likelihood * share[:, None], log_alike * share
    facings: dict[int, FloatArray] = {}
    axis: IntArray = np.full(len(data.rows), -1)
    estimates = []
    towards = np.array([towards_microphone(place) for place in data.places])
    source_of = [unit_name(row, "source") for row in data.rows]
    for source in sorted({source_of[n] for n in unknown}):
        members = [int(n) for n in unknown if source_of[n] == source]
        by_position, by_direct_sound = (_sharing(members, keys) for keys in (position, direct_sound))
        # one that radiates alike in all directions would seem to face half away from all microphones
        of_sources = np.concatenate([log_likelihood[:, members, 0], log_alike[:, members]]).sum(axis=1)
        log_towards = float(logsumexp(of_sources) - np.log(len(of_sources)))
        fixed, log_fixed = _best_axes(by_position, towards, log_likelihood)
        free, log_free = _best_axes(by_direct_sound, towards, log_likelihood)
        evidence = {"fixed": float(log_fixed - log_towards), "free": float(log_free - log_towards)}
        hypothesis: Hypothesis = "towards the microphone"
        of_source = {n: towards[n] for n in members}
        if max(evidence.values()) > _DECISIVE:
            hypothesis, of_source = ("fixed", fixed) if log_fixed >= log_free else ("free", free)
            for rirs in by_position if hypothesis == "fixed" else by_direct_sound:
                axis[rirs] = axis.max() + 1
        estimates.append(FacingEstimate(source, len(members), len(by_position), hypothesis, evidence,
                                        mean_angle_deg(data, of_source)))
        facings.update(of_source)
    return replace(with_facings(data, facings), facings=tuple(estimates), axis=axis)


def mean_angle_deg(data: Data, facings: Mapping[int, FloatArray]) -> float:
    """Return the mean angle between the facings of some RIRs, unit vectors, and the directions of the microphones."""
    cosines = [towards_microphone(data.places[n]) @ facing for n, facing in facings.items()]
    return float(np.degrees(np.mean(np.arccos(np.clip(cosines, -1.0, 1.0)))))


def _best_axes(groups: list[list[int]], towards: FloatArray, log_likelihood: FloatArray
               ) -> tuple[dict[int, FloatArray], float]:
    """Return the best facing of each RIR where the RIRs of a group share one, and the log evidence of all groups.

    The likelihood is that of `_log_likelihood`.
    """
    n_assumed = len(log_likelihood)
    best: list[dict[int, FloatArray]] = [{} for _ in range(n_assumed)]
    evidence = np.zeros(n_assumed)
    for rirs in groups:
        angles = np.arccos(np.clip(towards[rirs] @ _AXES.T, -1.0, 1.0))  # (n_rirs_of_group, n_axes)
        (before, part), rir = _on_grid(angles), np.array(rirs)[:, None]
        of_rirs = log_likelihood[:, rir, before] * (1.0 - part) + log_likelihood[:, rir, before + 1] * part
        of_axes = of_rirs.sum(axis=1)
        evidence += logsumexp(of_axes, axis=1) - np.log(len(_AXES))
        for of_assumed, axis in zip(best, np.argmax(of_axes, axis=1), strict=True):
            of_assumed.update(dict.fromkeys(rirs, _AXES[axis]))
    return best[int(np.argmax(evidence))], float(logsumexp(evidence) - np.log(n_assumed))


def _on_grid(angles: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the number of the angle of `_TEST_ANGLES` below some angles, and their place from there to the next."""
    place = angles / _TEST_ANGLES[1]
    before = np.minimum(place.astype(int), len(_TEST_ANGLES) - 2)
    return before, place - before


def _log_likelihood(data: Data, index: ParameterIndex, mean: FloatArray, local: list[FloatArray],
                    residual: FloatArray, spread: FloatArray, nj: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return the log likelihood of the direct sound of each RIR, with some directivities and without any.

    Reflections leave in all directions, so that their gain is the mean over the sphere. The response of the source
    colours both, and its estimate from the reflections is taken from the residual of the direct sound. The model's own
    directivity, fitted or given, is taken out first.

    Returns
    -------
    of_angles : ndarray, shape (n_assumed, n_rirs, n_angles)
        At `_TEST_ANGLES` from the axis, for each assumed directivity and scale of the scatter.
    alike : ndarray, shape (n_scales, n_rirs)
        Of a source that radiates alike in all directions, for each scale.
    """
    rest = [k for k, effect in enumerate(index.effects) if effect is not SourceDirectivity]
    absorption, vectors = index.absorption(mean, local), index.vectors(mean, local)
    others, vectors_of_others = [index.effects[k] for k in rest], [vectors[k] for k in rest]
    possible = _directivities(data)
    data = replace(data, given=[[effect for effect in of_rir if not isinstance(effect, SourceDirectivity)]
                                for of_rir in data.given])
    plain = ParameterIndex(data, others).predict(absorption, vectors_of_others)
    residual = residual + index.predict(absorption, vectors) - plain
    used = (METRIC == "direct") & CALIBRATION_FEATURES
    direct = residual[:, used] - _colour(data, residual, BAND_OF_FEATURE[used])
    diffuse = [replace(table, angular=np.tile(OF_SPHERE.astype(np.float32), (len(table.entries), 1)))
               for table in data.tables]

    def log_likelihood(change: FloatArray) -> FloatArray:
        # relative to the reflections, which the directivity changes as well
        error = (direct - (change[:, used] - _octaves(change, "late")[:, BAND_OF_FEATURE[used]])) / spread[used]
        measured = np.isfinite(error).sum(axis=1)
        independent = np.minimum(measured, _INDEPENDENT)
        square = [np.nansum(np.minimum((error / scale) ** 2, 9.0), axis=1) for scale in _SCALES]
        return -0.5 * independent / np.maximum(measured, 1) * square - np.outer(np.log(_SCALES), independent)

    source_of = np.array([unit_name(row, "source") for row in data.rows])

    def state_of(data: Data, directivities: dict[str, SourceDirectivity]) -> PredictionState:
        state = ParameterIndex(data, others).state(absorption, vectors_of_others)
        for name, directivity in directivities.items():
            directivity.apply_to_prediction(state, data, np.flatnonzero(source_of == name))
        return state

    at_any = replace(data, tables=diffuse)
    reflected = [ReflectedEnergy(at_any, state_of(at_any, directivities)) for directivities in possible]

    def at_angle(angle: float) -> FloatArray:
        at_one = replace(data, tables=[replace(table, direct_angle=angle) for table in diffuse])
        return np.concatenate([log_likelihood(predict(at_one, state_of(at_one, directivities), energy.copy()) - plain)
                               for directivities, energy in zip(possible, reflected, strict=True)])

    of_angles = share_out(at_angle, _TEST_ANGLES.tolist(), nj, first_here=False, label="facings of sources")
    return np.stack(of_angles, axis=2), log_likelihood(np.zeros_like(plain))


def _directivities(data: Data) -> list[dict[str, SourceDirectivity]]:
    """Return directivities that sources may have: of cabinets of several sizes, and those of the base model, if any.

    One that was fitted with assumed facings would confirm them: with a lobe where the microphones were taken to be.
    """
    names = data.units("source")[0]
    possible = [dict.fromkeys(names, SourceDirectivity.from_vector(start)) for start in SourceDirectivity.STARTS]
    if given := {unit_name(row, "source"): effect for row, effects in zip(data.rows, data.given, strict=True)
                 for effect in effects if isinstance(effect, SourceDirectivity)}:
        possible.append(given)
    return possible


def _sharing(rirs: list[int], keys: Sequence[Hashable]) -> list[list[int]]:
    """Return some RIRs in groups that share a key; `keys` has one for each RIR of the data."""
    return [[rirs[n] for n in group] for group in numbers_by(keys[rir] for rir in rirs).values()]


def _position(data: Data, n: int) -> tuple:
    """Return what RIRs of one position of a source share; states of one room, such as open curtains, share it too."""
    row, (x_m, y_m, _) = data.rows[n], data.places[n].source_pos_m
    # as documented: estimates of dimensions and heights differ between states
    room = row["room_id"] if row.get("mesh") else tuple(data.documented[n].get("room_dims_m") or ())
    return room, round(x_m, 1), round(y_m, 1)


def _direct_sound(data: Data, n: int) -> tuple:
    """Return what RIRs share that have one direct sound: those of a source and a microphone that stay, as states do."""
    x_m, y_m, _ = data.places[n].mic_pos_m
    height_m = (data.documented[n].get("mic_pos_m") or (None,))[-1]
    return (unit_name(data.rows[n], "source"), *_position(data, n), round(x_m, 1), round(y_m, 1),
            None if height_m is None else round(height_m, 1))


def _octaves(features: FloatArray, metric: str) -> FloatArray:
    return features[:, METRIC == metric]


def _colour(data: Data, residual: FloatArray, bands: IntArray) -> FloatArray:
    """Return the response of each RIR's source as its late reflections show it, at some octaves [dB]."""
    names, unit = data.units("source")
    late = _octaves(residual, "late")
    colour = np.zeros((len(names), late.shape[1]))
    for u in range(len(names)):
        of_source = late[unit == u]
        seen = np.isfinite(of_source).any(axis=0)
        colour[u, seen] = np.nanmedian(of_source[:, seen], axis=0)
    return colour[unit][:, bands]


def with_facings(data: Data, facings: Mapping[int, FloatArray]) -> Data:
    """Return data in which the sources of some RIRs face in some directions, unit vectors by the number of an RIR."""
    rows, tables = list(data.rows), list(data.tables)
    for n, facing in facings.items():
        rows[n] = {**rows[n], "source_dir": [float(x) for x in facing]}
        if not same(tables[n].facing, facing):  # an estimate that is made again often finds the same
            departures = cast(StoredArray, tables[n].departures).load()
            tables[n] = turned(tables[n], departures, towards_microphone(data.places[n]), facing)
    return replace(data, rows=rows, tables=tables)
