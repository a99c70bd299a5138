"""Where loudspeakers face, if nobody wrote it down: towards the microphone, or in a direction of their own.

The direct sound tells. A loudspeaker that faces the microphone sends its direct sound with the gain of its axis; one
that faces elsewhere sends less of it, above all at high frequencies, while its reflections stay. Of the direct sound,
only the features of `roomeq.loop.features.CALIBRATION_FEATURES` take part, which are never scored. Of the reflections,
the median over all RIRs of a source takes part, the scored ones among them: it takes out the source's response.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.rng import rng_for
from roomeq.effects.source_directivity import SourceDirectivity, unit_facing
from roomeq.loop.data import LENGTHS_S, Data
from roomeq.loop.facing_estimate import FacingEstimate, Hypothesis
from roomeq.loop.features import BAND_OF_FEATURE, CALIBRATION_FEATURES, METRIC
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.path_samples import decay_range_s, draw_path_samples
from roomeq.loop.predict import predict
from roomeq.loop.session import Session
from roomeq.loop.tables import ANGLES, collect
from roomeq.records.schema import unit_name

_AXES = np.array([(np.cos(azimuth), np.sin(azimuth), 0.0) for azimuth in np.radians(np.arange(0.0, 360.0, 10.0))])
"""Horizontal directions that are compared."""
_TEST_ANGLES = np.linspace(0.0, np.pi, 13)
_INDEPENDENT = 3.0  # of the third octaves of a direct sound, which err together
_DECISIVE = 3.0  # natural logarithm of the Bayes factor that other directions than the microphone's need


def unknown_facings(data: Data) -> IntArray:
    """Return the RIRs whose source faces nobody knows where."""
    return np.flatnonzero([unit_facing(row.get("source_dir")) is None for row in data.rows])


def with_estimated_facings(session: Session) -> Session:
    """Return a session whose sources all face somewhere (`Data.facings`)."""
    data, fitted = session.data, session.fit
    typical = SourceDirectivity.from_vector(SourceDirectivity.STARTS[0])
    return replace(session, data=estimate_facings(
        data, session.index, fitted.mean, fitted.local, session.residual, np.hypot(fitted.sigma, fitted.omega),
        dict.fromkeys(data.units("source")[0], typical)))


def estimate_facings(data: Data, index: ParameterIndex, mean: FloatArray, local: list[FloatArray],
                     residual: FloatArray, spread: FloatArray, directivities: Mapping[str, SourceDirectivity]
                     ) -> Data:
    """Return data with an estimate of each unknown facing.

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
    directivities : mapping
        Assumed directivity of each source.
    """
    unknown = unknown_facings(data)
    if not len(unknown):
        return data
    log_likelihood = _log_likelihood(data, index, mean, local, residual, spread, directivities)
    facings: dict[int, FloatArray] = {}
    estimates = []
    towards = _towards(data)
    source_of = [unit_name(row, "source") for row in data.rows]
    for source in sorted({source_of[n] for n in unknown}):
        members = [int(n) for n in unknown if source_of[n] == source]
        by_position: dict[tuple, list[int]] = {}
        for n in members:
            by_position.setdefault(_position(data, n), []).append(n)
        log_towards = float(log_likelihood[members, 0].sum())
        fixed, log_fixed = _best_axes(by_position.values(), towards, log_likelihood)
        free, log_free = _best_axes([[n] for n in members], towards, log_likelihood)
        evidence = {"fixed": float(log_fixed - log_towards), "free": float(log_free - log_towards)}
        hypothesis: Hypothesis = "towards the microphone"
        of_source = {n: towards[n] for n in members}
        if max(evidence.values()) > _DECISIVE:
            hypothesis, of_source = ("fixed", fixed) if log_fixed >= log_free else ("free", free)
        angle = np.mean([np.arccos(np.clip(towards[n] @ facing, -1.0, 1.0)) for n, facing in of_source.items()])
        estimates.append(FacingEstimate(source, len(members), len(by_position), hypothesis, evidence,
                                        float(np.degrees(angle))))
        facings.update(of_source)
    return replace(with_facings(data, facings), facings=tuple(estimates))


def facing_the_microphone(data: Data) -> Data:
    """Return data in which each source with unknown facing faces the microphone."""
    towards = _towards(data)
    return with_facings(data, {int(n): towards[n] for n in unknown_facings(data)})


def _towards(data: Data) -> FloatArray:
    """Unit vectors from each source to its microphone, shape (n_rirs, 3)."""
    towards = np.array([np.subtract(place.mic_pos_m, place.source_pos_m) for place in data.places])
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def _best_axes(groups: Iterable[list[int]], towards: FloatArray, log_likelihood: FloatArray
               ) -> tuple[dict[int, FloatArray], float]:
    """Return the best facing of each RIR where the RIRs of a group share one, and the log evidence of all groups."""
    best, evidence = {}, 0.0
    for rirs in groups:
        angles = np.arccos(np.clip(towards[rirs] @ _AXES.T, -1.0, 1.0))  # (n_rirs_of_group, n_axes)
        of_axes = np.sum([np.interp(angles[i], _TEST_ANGLES, log_likelihood[n]) for i, n in enumerate(rirs)], axis=0)
        evidence += float(logsumexp(of_axes)) - np.log(len(_AXES))
        best.update(dict.fromkeys(rirs, _AXES[int(np.argmax(of_axes))]))
    return best, evidence


def _log_likelihood(data: Data, index: ParameterIndex, mean: FloatArray, local: list[FloatArray],
                    residual: FloatArray, spread: FloatArray, directivities: Mapping[str, SourceDirectivity]
                    ) -> FloatArray:
    """Return the log likelihood of the direct sound of each RIR at `_TEST_ANGLES`, shape (n_rirs, n_angles).

    Reflections leave in all directions, so that their gain is the mean over the sphere. The response of the source
    colours both, and its estimate from the reflections is taken from the residual of the direct sound.
    """
    absorption, vectors = index.absorption(mean, local), index.vectors(mean, local)
    plain = index.predict(absorption, vectors, np.zeros(len(data.rows)), 0.0)
    used = (METRIC == "direct") & CALIBRATION_FEATURES
    direct = residual[:, used] - _colour(data, residual, BAND_OF_FEATURE[used])
    sphere = (np.gradient(-np.cos(ANGLES)) / 2.0).astype(np.float32)
    diffuse = [replace(table, angular=np.tile(sphere / sphere.sum(), (len(table.entries), 1))) for table in data.tables]
    of_angles, source_of = [], np.array([unit_name(row, "source") for row in data.rows])
    for angle in _TEST_ANGLES:
        turned = replace(data, tables=[replace(table, direct_angle=float(angle)) for table in diffuse])
        state = ParameterIndex(turned, index.effects).state(absorption, vectors)
        for name, directivity in directivities.items():
            rows = np.flatnonzero(source_of == name)
            directivity.apply_to_prediction(state, turned, rows)
        change = predict(turned, state) - plain
        # relative to the reflections, which the directivity changes as well
        error = direct - (change[:, used] - _octaves(change, "late")[:, BAND_OF_FEATURE[used]])
        square = np.minimum((error / spread[used]) ** 2, 9.0)
        measured = np.isfinite(square).sum(axis=1)
        of_angles.append(-0.5 * np.nansum(square, axis=1) * np.minimum(1.0, _INDEPENDENT / np.maximum(measured, 1)))
    return np.array(of_angles).T


def _position(data: Data, n: int) -> tuple:
    """Return what RIRs of one position of a source share; states of one room, such as open curtains, share it too."""
    row, (x_m, y_m, _) = data.rows[n], data.places[n].source_pos_m
    room = row["room_id"] if row.get("mesh") else tuple(row["room_dims_m"] or ())
    return room, round(x_m, 1), round(y_m, 1)


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
    """Return data in which the sources of some RIRs face in some directions, unit vectors."""
    rows, tables, path_samples = list(data.rows), list(data.tables), list(data.path_samples)
    by_trace: dict[int, list[int]] = {}
    for n, facing in facings.items():
        rows[n] = {**rows[n], "source_dir": [float(x) for x in facing]}
        by_trace.setdefault(id(data.traced[n]), []).append(n)
    for members in by_trace.values():
        traced, mics_m = data.traced[members[0]].load(), np.array([data.places[n].mic_pos_m for n in members])
        of_members = [facings[n] for n in members]
        drawn = draw_path_samples(traced, mics_m, of_members,
                                  decay_range_s(data.features[members], data.valid[members], LENGTHS_S[0]),
                                  [rng_for(data.seed, "loop paths", data.rows[n]["id"]) for n in members])
        for n, table, sample in zip(members, collect(traced, mics_m, of_members), drawn, strict=True):
            tables[n], path_samples[n] = table, sample
    return replace(data, rows=rows, tables=tables, path_samples=path_samples)
