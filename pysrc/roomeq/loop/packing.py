"""Parameters of a model of all rooms: their positions in vectors, the features predicted from them, and derivatives.

Conventions
-----------
`mean` holds the shared parameters: the mean over rooms of the surface parameters, then for each effect the vectors of
its units, or the mean vector of effects whose scope is the room or the RIR. ``local[r]`` holds the own parameters of
room r: the deviations of its surface parameters, its gains, and the deviations of the effects whose scope is the room
or the RIR.

Surface parameters of a room are its absorption per band, ``x = ln(-ln(1 - alpha))``, and the contrast of floor and
ceiling to the walls.

A chain of room, source, microphone and recording session that several RIRs share has its own gain. A chain of one RIR,
as in corpora that number positions instead of devices, would leave the gain of a held-out RIR undetermined: its gain is
the sum of a gain of the room and session, one of the source in that room and one of the microphone in that room. An RIR
whose level cannot be compared (`roomeq.loop.measurability`) has a gain of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.effects.base import Effect
from roomeq.effects.model import is_directive
from roomeq.effects.prediction import PredictionState
from roomeq.loop.data import Data
from roomeq.loop.features import HAS_GAIN, METRIC
from roomeq.loop.predict import (
    BANDS_APART,
    DEPENDS_ON_BAND,
    N_BANDS,
    Predicted,
    ReflectedEnergy,
    base_state,
    drr,
    predict,
    predict_by_band,
)
from roomeq.loop.ray_energy import sum_rays
from roomeq.records.schema import session_name

OWN_SCOPES = ("room", "rir")
"""Scopes of effects whose vectors belong to one room alone."""
N_SURFACE = 2 * N_BANDS
"""Number of surface parameters of a room."""
GAIN_KINDS = ("chain", "source", "mic", "rir")
"""Kinds of gains: of a chain or of a room and session, the deviations of a source and of a microphone from it, and that
of a single RIR whose level says nothing."""
LEVEL_KINDS = (GAIN_KINDS.index("chain"), GAIN_KINDS.index("rir"))
"""Kinds of gains of which each RIR has one, to which those of source and microphone may be added."""
_STEP = 0.003  # of numerical derivatives, in units of a vector's spread; with ten times as much steps went uphill
_SURFACE_STEP = 1e-4  # of those by surface parameters: late energy, linear in it, would be 3 % off with the step above
_SAME_JND = 0.03
"""Change of the features (rms) over which derivatives are taken as constant."""


class SharedPart(NamedTuple):
    """Position of an effect's vectors among the shared parameters.

    Attributes
    ----------
    part : slice
    n_vectors : int
        One for each unit, or one in all for the scopes of `OWN_SCOPES`.
    unit : ndarray of int, shape (n_rirs,)
        Number of the unit of each RIR.
    size : int
        Length of a vector.
    """

    part: slice
    n_vectors: int
    unit: IntArray
    size: int


class LocalPart(NamedTuple):
    """Positions in a room's own parameters: the slice of each effect, and the number of parameters."""

    slices: list[slice]
    size: int


class Derivatives(NamedTuple):
    """Derivatives of all features.

    Attributes
    ----------
    by_surface : ndarray, shape (n_rirs, n_features, N_SURFACE)
    by_effect : mapping of ndarray, shape (n_rirs, n_features, n)
        By the vector of each effect.
    """

    by_surface: FloatArray
    by_effect: Mapping[type[Effect], FloatArray]


class _Prediction(NamedTuple):
    """A prediction with what its derivatives need (`ParameterIndex.predict_at`).

    Attributes
    ----------
    vectors : list of ndarray
        Of each effect (`ParameterIndex.vectors`).
    before : list of PredictionState
        Before each effect.
    state : PredictionState
    reflected : ReflectedEnergy
    predicted : Predicted
    gains : ndarray, shape (n_rirs, n_features)
        Of the recordings.
    """

    vectors: list[FloatArray]
    before: list[PredictionState]
    state: PredictionState
    reflected: ReflectedEnergy
    predicted: Predicted
    gains: FloatArray

    @property
    def features(self) -> FloatArray:
        return self.predicted.features + self.gains


class ParameterIndex:
    """Positions of all parameters of a model, and the features that follow from them.

    Attributes
    ----------
    data : Data
    effects : tuple of types
    shared : list of SharedPart
        Of each effect.
    n_shared : int
    local : list of LocalPart
        Of each room.
    members : list of ndarray of int
        RIRs of each room.
    columns : list of ndarray of int, shape (n_columns,)
        Of each room: the shared parameters on which its RIRs depend, which are those of its own units.
    own_place : list of ndarray of int, shape (n_own,)
        Of each room: places of its own parameters in a list of `columns` and of those that are its own alone. A room's
        deviation from a shared parameter acts as that parameter does, and has its place.
    gain_design : list of ndarray, shape (n_rirs_of_room, n_gains)
        Of each room: 1 where a gain applies to an RIR, else 0.
    gain_kind : list of ndarray of int, shape (n_gains,)
        Of each room: index in `GAIN_KINDS`.
    """

    def __init__(self, data: Data, effects: Sequence[type[Effect]]) -> None:
        self.data, self.effects = data, tuple(effects)
        self.shared: list[SharedPart] = []
        start = N_SURFACE
        for effect in self.effects:
            names, unit = data.units(effect.SCOPE)
            size = len(effect.SPREAD)
            n_vectors = 1 if effect.SCOPE in OWN_SCOPES else len(names)
            self.shared.append(SharedPart(slice(start, start + n_vectors * size), n_vectors, unit, size))
            start += n_vectors * size
        self.n_shared = start
        self.members = [np.flatnonzero(data.room == r) for r in range(len(data.room_names))]
        self.columns = [self._columns(members) for members in self.members]
        self.gain_design, self.gain_kind = zip(*[_gains(data, members) for members in self.members], strict=True)
        self.local: list[LocalPart] = []
        for kinds, members in zip(self.gain_kind, self.members, strict=True):
            at, slices = N_SURFACE + len(kinds), []
            for effect in self.effects:
                size = len(effect.SPREAD) * {"room": 1, "rir": len(members)}.get(effect.SCOPE, 0)
                slices.append(slice(at, at + size))
                at += size
            self.local.append(LocalPart(slices, at))
        self.own_place = [self._own_places(r) for r in range(len(self.members))]
        self._places: dict[int, list[IntArray]] = {}  # of rooms, when they are needed

    def _columns(self, members: IntArray) -> IntArray:
        columns = [np.arange(N_SURFACE)]
        for effect, (part, _, unit, size) in zip(self.effects, self.shared, strict=True):
            units = np.zeros(1, dtype=int) if effect.SCOPE in OWN_SCOPES else np.unique(unit[members])
            columns += [part.start + u * size + np.arange(size) for u in units]
        return np.concatenate(columns)

    def _own_places(self, r: int) -> IntArray:
        slices, size = self.local[r]
        place = np.full(size, -1)
        place[:N_SURFACE] = np.arange(N_SURFACE)
        for k, effect in enumerate(self.effects):
            if effect.SCOPE == "room":
                place[slices[k]] = self._first_column(r, k) + np.arange(self.shared[k].size)
        alone = np.flatnonzero(place < 0)
        place[alone] = len(self.columns[r]) + np.arange(len(alone))
        return place

    def _first_column(self, r: int, k: int) -> int:
        """Place among the `columns` of a room of the first vector of an effect."""
        return int(np.searchsorted(self.columns[r], self.shared[k].part.start))

    def vectors(self, mean: FloatArray, local: list[FloatArray]) -> list[FloatArray]:
        """Return the vectors of each effect's units: list of arrays, shape (n_units, n)."""
        vectors = []
        for k, effect in enumerate(self.effects):
            part, n_vectors, _, size = self.shared[k]
            if effect.SCOPE == "room":
                vectors.append(np.array([mean[part] + local[r][self.local[r].slices[k]]
                                         for r in range(len(local))]).reshape(len(local), size))
            elif effect.SCOPE == "rir":
                of_rirs = np.empty((len(self.data.rows), size))
                for r, members in enumerate(self.members):
                    of_rirs[members] = mean[part] + local[r][self.local[r].slices[k]].reshape(len(members), size)
                vectors.append(of_rirs)
            else:
                vectors.append(mean[part].reshape(n_vectors, size))
        return vectors

    def absorption(self, mean: FloatArray, local: list[FloatArray]) -> FloatArray:
        """Return ``-ln(1 - alpha)`` of the walls, and of floor and ceiling, shape (n_rooms, 2, 8)."""
        surface = np.array([mean[:N_SURFACE] + own[:N_SURFACE] for own in local])
        average, contrast = surface[:, :N_BANDS], surface[:, N_BANDS:]
        return np.exp(np.stack([average - 0.5 * contrast, average + 0.5 * contrast], axis=1))

    def gains(self, local: list[FloatArray]) -> FloatArray:
        """Return the gain of each RIR [dB], shape (n_rirs,)."""
        gains = np.empty(len(self.data.rows))
        for members, design, own in zip(self.members, self.gain_design, local, strict=True):
            gains[members] = design @ own[N_SURFACE:N_SURFACE + design.shape[1]]
        return gains

    def state(self, absorption: FloatArray, vectors: list[FloatArray]) -> PredictionState:
        """Return the state of each RIR: the base model's, changed by the effects."""
        state = base_state(self.data, absorption)
        for k in range(len(self.effects)):
            self._apply(k, vectors[k], state)
        return state

    def _apply(self, k: int, vectors: FloatArray, state: PredictionState, room: int | None = None) -> None:
        """Change a state by the effect number `k`, in place; in all rooms, or in one."""
        for vector, of_unit in zip(vectors, self._rows_of_units[k], strict=True):
            rows = of_unit if room is None else of_unit[self.data.room[of_unit] == room]
            if len(rows):
                self.effects[k].from_vector(vector).apply_to_prediction(state, self.data, rows)

    @cached_property
    def _rows_of_units(self) -> list[list[IntArray]]:
        """RIRs of each unit of each effect."""
        n_units = [len(self.data.units(effect.SCOPE)[0]) for effect in self.effects]
        return [[np.flatnonzero(part.unit == u) for u in range(count)]
                for part, count in zip(self.shared, n_units, strict=True)]

    def predict(self, absorption: FloatArray, vectors: list[FloatArray], gains: FloatArray | float = 0.0,
                correction: FloatArray | float = 0.0, reflected: ReflectedEnergy | None = None) -> FloatArray:
        """Return predicted features, shape (n_rirs, n_features); `reflected` as for `roomeq.loop.predict.predict`."""
        return predict(self.data, self.state(absorption, vectors), reflected) + correction + np.outer(gains, HAS_GAIN)

    def predict_rooms(self, absorption: FloatArray, vectors: list[list[FloatArray]]) -> FloatArray:
        """Return predicted features, (n_rirs, n_features), where each room has its own vectors of all units."""
        state = base_state(self.data, absorption)
        for k in range(len(self.effects)):
            for room, of_room in enumerate(vectors):
                self._apply(k, of_room[k], state, room)
        return predict(self.data, state)

    def predict_at(self, mean: FloatArray, local: list[FloatArray], known: Derivatives | None = None) -> "_Prediction":
        """Return a prediction from which `linearize` can go on; arguments as there."""
        vectors, state, before = self.vectors(mean, local), base_state(self.data, self.absorption(mean, local)), []
        for k, of_effect in enumerate(vectors):
            before.append(state.copy())
            self._apply(k, of_effect, state)
        unknown = set(self.effects).difference(known.by_effect if known else ())
        rays = sum_rays(self.data, state, by_absorption=known is None, by_angle=any(map(is_directive, unknown)))
        reflected = ReflectedEnergy(self.data, state, rays)
        return _Prediction(vectors, before, state, reflected, predict_by_band(self.data, state, reflected),
                           np.outer(self.gains(local), HAS_GAIN))

    def linearize(self, mean: FloatArray, local: list[FloatArray], correction: FloatArray,
                  known: Derivatives | None = None, at: "_Prediction | None" = None) -> tuple[FloatArray, Derivatives]:
        """Return predicted features, shape (n_rirs, n_features), and their derivatives.

        Parameters
        ----------
        mean, local
            Where to linearize.
        correction : ndarray, shape (n_rirs, n_features)
            Rendering correction.
        known : Derivatives, optional
            Derivatives that are not computed again, by the surface parameters and by any effects.
        at : _Prediction, optional
            Of `predict_at` with the same arguments.
        """
        at = at or self.predict_at(mean, local, known)
        centre, reflected = at.predicted, at.reflected

        def by_absorption(bands: list[int], step: tuple[float, float]) -> FloatArray:
            # no effect changes the absorption, and none depends on it
            moved = replace(at.state, absorption=at.state.absorption.copy())
            moved.absorption[:, :, bands] *= np.exp(_SURFACE_STEP * np.array(step))[:, None]
            moved_to = predict_by_band(self.data, moved, reflected.moved_to(moved, bands))
            return _slopes(centre, moved_to, bands, _SURFACE_STEP)

        def by_vector(k: int, group: list[int]) -> FloatArray:
            effect, moved, moved_state = self.effects[k], at.vectors[k].copy(), at.before[k].copy()
            steps = _STEP * np.array(effect.SPREAD)[group]
            moved[:, group] += steps
            for later, of_effect in enumerate([moved, *at.vectors[k + 1:]], k):
                self._apply(later, of_effect, moved_state)
            bands = [band for p in group if (band := effect.BANDS[p] if effect.BANDS else None) is not None]
            moved_to = predict_by_band(self.data, moved_state, reflected.moved_to(moved_state, bands)
                                       if effect.REFLECTIONS else reflected.copy(bands))
            return (_slopes(centre, moved_to, bands, steps) if bands else
                    (moved_to.features - centre.features)[:, :, None] / steps)

        if known is None:
            by_surface = np.empty((*centre.features.shape, N_SURFACE))
            for bands in _separate(range(N_BANDS)):
                for first, step in ((0, (1.0, 1.0)), (N_BANDS, (-0.5, 0.5))):
                    by_surface[:, :, [first + band for band in bands]] = by_absorption(bands, step)
        else:
            by_surface = known.by_surface
        by_effect = {effect: known.by_effect[effect] for effect in self.effects if known and effect in known.by_effect}
        for k, effect in enumerate(self.effects):
            if effect not in by_effect:
                by_effect[effect] = np.empty((*centre.features.shape, len(effect.SPREAD)))
                for group in _groups_of(effect):
                    by_effect[effect][:, :, group] = by_vector(k, group)
        return at.features + correction, Derivatives(by_surface, by_effect)

    def room_derivatives(self, r: int, derivatives: Derivatives) -> list[tuple[FloatArray, IntArray]]:
        """Return derivatives of a room's RIRs by the parameters of `room_places`, in parts.

        Each part is an array, shape (n, n_features, n_of_part), and its rows for the RIRs of the room.
        """
        members, (by_surface, by_effect) = self.members[r], derivatives
        by_gain = HAS_GAIN[:, None] * self.gain_design[r][:, None, :]
        parts = [(by_surface, members), (by_gain, np.arange(len(members)))]
        for effect in self.effects:
            parts += [(by_effect[effect], members)] * (2 if effect.SCOPE == "rir" else 1)
        return parts

    def room_places(self, r: int) -> list[IntArray]:
        """Return which parameters the RIRs of a room depend on, for each part of `room_derivatives`.

        Each array, shape (n_rirs_of_room, n_of_part), holds the places of these parameters in the list that `own_place`
        refers to.
        """
        if r not in self._places:
            members, slices, design = self.members[r], self.local[r].slices, self.gain_design[r]
            n_rirs, gains = len(members), self.own_place[r][N_SURFACE:N_SURFACE + design.shape[1]]
            places = [np.tile(part, (n_rirs, 1)) for part in (np.arange(N_SURFACE), gains)]
            for k, effect in enumerate(self.effects):
                part, _, unit, n = self.shared[k]
                vector = np.zeros(n_rirs, dtype=int) if effect.SCOPE in OWN_SCOPES else unit[members]
                places.append(np.searchsorted(self.columns[r], part.start + vector * n)[:, None] + np.arange(n))
                if effect.SCOPE == "rir":
                    places.append(np.ascontiguousarray(self.own_place[r][slices[k]].reshape(n_rirs, n)))
            self._places[r] = places
        return self._places[r]


class Linearization:
    """Predicted features and their derivatives on the way of a fit; derivatives are kept while features hardly change.

    Parameters
    ----------
    index : ParameterIndex
    correction, known
        As for `ParameterIndex.linearize`.
    """

    def __init__(self, index: ParameterIndex, correction: FloatArray, known: Derivatives | None = None) -> None:
        self.index, self._correction, self._known = index, correction, known
        self._newest: tuple[FloatArray, list[FloatArray], _Prediction] | None = None
        self._linearized: tuple[FloatArray, Derivatives] | None = None

    def _predict_at(self, mean: FloatArray, local: list[FloatArray]) -> _Prediction:
        if self._newest is None or self._newest[0] is not mean or self._newest[1] is not local:
            self._newest = mean, local, self.index.predict_at(mean, local, self._known)
        return self._newest[2]

    def predicted(self, mean: FloatArray, local: list[FloatArray]) -> FloatArray:
        """Return predicted features, shape (n_rirs, n_features); they are known where the last call was."""
        return self._predict_at(mean, local).features + self._correction

    def at(self, mean: FloatArray, local: list[FloatArray], same_jnd: float = _SAME_JND
           ) -> tuple[FloatArray, Derivatives]:
        """Return predicted features, and their derivatives there or where the features differ by `same_jnd` (rms)."""
        if self._linearized is not None:
            predicted, (origin, derivatives) = self.predicted(mean, local), self._linearized
            change = (predicted - origin)[self.index.data.valid]
            if not len(change) or np.sqrt(np.mean(change ** 2)) <= same_jnd:
                return predicted, derivatives
        self._linearized = self.index.linearize(mean, local, self._correction, self._known,
                                                self._predict_at(mean, local))
        return self._linearized


def _separate(bands: Sequence[int]) -> list[list[int]]:
    """Distribute bands to groups in which no two share a feature: one prediction gives the slopes of a whole group."""
    return [[band for band in bands if band % BANDS_APART == n] for n in range(BANDS_APART)]


def _groups_of(effect: type[Effect]) -> list[list[int]]:
    """Distribute the components of an effect's vector to groups that one prediction can move together."""
    bands = effect.BANDS or (None,) * len(effect.SPREAD)
    groups: list[dict[int, int]] = []  # band of each component
    for p, band in enumerate(bands):
        if band is None:
            groups.append({p: -BANDS_APART})
            continue
        for group in groups:
            if all(abs(other - band) >= BANDS_APART for other in group.values()) and min(group.values()) >= 0:
                group[p] = band
                break
        else:
            groups.append({p: band})
    return [list(group) for group in groups]


def _slopes(centre: Predicted, moved: Predicted, bands: Sequence[int], step: float | FloatArray) -> FloatArray:
    """Return the slopes of features over parameters of several bands moved together, (n_rirs, n_features, n_bands)."""
    slopes = np.where(DEPENDS_ON_BAND[:, bands], (moved.features - centre.features)[:, :, None], 0.0)
    for i, band in enumerate(bands):
        energy = centre.drr_energy.copy()
        energy[:, :, band] = moved.drr_energy[:, :, band]
        slopes[:, METRIC == "drr", i] = (drr(energy) - drr(centre.drr_energy))[:, None]
    return slopes / step


def _gains(data: Data, members: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the gain design of a room and the kind of each gain (see `ParameterIndex`)."""
    chain, comparable = data.chain[members], data.comparable[members]
    count = np.array([np.sum(chain == number) for number in chain])
    columns: list[tuple[BoolArray, int]] = [(comparable & (chain == number), 0)
                                            for number in np.unique(chain[comparable & (count > 1)])]
    alone = comparable & (count == 1)
    session: Any = np.array([session_name(data.rows[n]) for n in members])
    columns += [(alone & (session == name), 0) for name in sorted(set(session[alone]))]
    for kind in (1, 2):
        names: Any = np.array([data.rows[n][f"{GAIN_KINDS[kind]}_id"] for n in members])
        several = sorted(set(names[alone]))
        columns += [(alone & (names == name), kind) for name in several if len(several) > 1]
    columns += [(np.arange(len(members)) == n, 3) for n in np.flatnonzero(~comparable)]
    return (np.stack([applies for applies, _ in columns], axis=1).astype(float),
            np.array([kind for _, kind in columns]))
