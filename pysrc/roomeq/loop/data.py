"""The measured RIRs of some rooms: their features, their geometry, and the ray contributions at their positions."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from scipy.cluster.hierarchy import fcluster, linkage

from roomeq.acoustics.jnd import DECAY_JND
from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.groups import numbers_by
from roomeq.core.progress import progress
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.effects.model import Model
from roomeq.effects.source_directivity import unit_facing
from roomeq.loop.facing_estimate import FacingEstimate
from roomeq.loop.features import METRIC, Features, feature_slice, measure_features
from roomeq.loop.geometry import Estimate, complete_geometry
from roomeq.loop.measurability import comparable_levels, limit_to_excitation
from roomeq.loop.path_samples import UNKNOWN_DECAYS_S, draw_path_samples
from roomeq.loop.tables import ANGLES, Table, collect, frame_edges_s, level_surfaces, turned
from roomeq.loop.traces import StoredSample, StoredTrace, TraceFile
from roomeq.loop.usable import LeftOut, UsableRirs
from roomeq.records.geometry import is_too_close, place_key
from roomeq.records.rir_dir import load_rir, rir_path
from roomeq.records.schema import RirRow, is_timed, session_name, stated_air, unit_name
from roomeq.sim.geometry import Place, find_place, towards_microphone
from roomeq.sim.render import MAX_LENGTH_S
from roomeq.sim.response import trace_source
from roomeq.sim.room import Room
from roomeq.sim.scene import Air, Material, Scene, check_positions, uniform_absorption

logger = logging.getLogger(__name__)

NUM_RAYS = 40000
"""Rays of each source. Fit and score share their noise, and an effect that is not there could take it out of both: with
10,000 rays, a `coupled_volume` lowered the error by 1 to 3 % in two sets of clean generated rooms, with 40,000 in
neither."""
SAME_PLACE_M = 0.15
"""Positions of a source that are closer than this are taken as one: positions are known to some centimetres."""
_MOVED_M = 0.02  # from which on it is said that a position is moved
_ONE_FACING_DEG = 10.0  # within which stated directions are one
LENGTHS_S = (0.4, MAX_LENGTH_S)
"""Limits of the length to which rays are traced."""
_MARGIN_TO_S = 3.0
"""Length up to which rays are traced beyond a decay by 60 dB, which is more than T30 needs: long traces take memory."""


@dataclass(frozen=True)
class Data:
    """RIRs of some rooms.

    Attributes
    ----------
    rows : list of RirRow
        Rows of the RIR directories, sorted by room and id.
    places : list of Place
    features, valid : ndarray, shape (n_rirs, n_features)
        What was measured, and which of it is valid (`roomeq.loop.features`).
    bounded : ndarray of bool, shape (n_rirs, n_features)
        Which features are upper limits instead (`roomeq.loop.features.Features`).
    white : ndarray, shape (n_rirs, 8)
        White noise of the recordings (`roomeq.loop.features.Features`).
    direct_sample : ndarray, shape (n_rirs,)
        Direct sample of each recording.
    n_samples : ndarray of int, shape (n_rirs,)
        Length of each recording without zeros or a fade-out at its end.
    comparable : ndarray of bool, shape (n_rirs,)
        Whether the level of a recording can be compared with others (`roomeq.loop.measurability`).
    room, chain : ndarray of int, shape (n_rirs,)
        Number of the room, and of the combination of room, source, microphone and recording session.
    place_number : ndarray of int, shape (n_rirs,)
        Number of the combination of room, source position and microphone position, as the rows state them
        (`roomeq.records.geometry.place_key`).
    room_names : list of str
    traced : list of StoredTrace
        Of each RIR; shared by the RIRs of one source.
    path_samples : list of StoredSample
        Of each RIR: the paths from which it is rendered with any absorption.
    tables : list of Table
    surface_per_m : ndarray, shape (n_rirs, 2)
        Area of the walls, and of floor and ceiling, over the volume of the room.
    air_per_m, speed_m_s, distance_m : ndarray, shape (n_rirs, 8), (n_rirs,), (n_rirs,)
        The declared air, and distances between source and microphone.
    rendered_changes : mapping
        See `rendered_change_of`.
    given : list of list of Effect
        Effects of each RIR that the base model has, with their parameters.
    documented : list of RirRow
        Rows as the directories state them, before any estimate.
    estimates : list of Estimate
        Estimated geometry, which places and rows have where it is used.
    left_out : list of LeftOut
        RIRs of the directories that are not in `rows`, by reason (`roomeq.loop.usable`).
    facings : tuple of FacingEstimate
        What was decided of sources whose rows do not state where they face.
    axis : ndarray of int, shape (n_rirs,)
        Number of the estimated axis that several RIRs may share; -1 where the facing is stated or is that towards the
        microphone. Empty if no facing has been estimated.
    """

    rows: list[RirRow]
    places: list[Place]
    features: FloatArray
    valid: BoolArray
    bounded: BoolArray
    white: FloatArray
    direct_sample: FloatArray
    n_samples: IntArray
    comparable: BoolArray
    room: IntArray
    chain: IntArray
    place_number: IntArray
    room_names: list[str]
    traced: list[StoredTrace]
    path_samples: list[StoredSample]
    tables: list[Table]
    surface_per_m: FloatArray
    air_per_m: FloatArray
    speed_m_s: FloatArray
    distance_m: FloatArray
    rendered_changes: Mapping[str, FloatArray]
    given: list[list[Effect]]
    documented: list[RirRow]
    estimates: list[Estimate]
    left_out: list[LeftOut]
    facings: tuple[FacingEstimate, ...] = ()
    axis: IntArray = field(default_factory=lambda: np.empty(0, dtype=int))

    angles = ANGLES

    @cached_property
    def frame_edges_s(self) -> FloatArray:
        """Edges of the frames of the reflected energy, shape (n_frames + 1,) (`roomeq.loop.tables.frame_edges_s`)."""
        return frame_edges_s(self.tables)

    @cached_property
    def frame_mid_s(self) -> FloatArray:
        """Middle of each frame, shape (n_frames,)."""
        return 0.5 * (self.frame_edges_s[1:] + self.frame_edges_s[:-1])

    @cached_property
    def given_to(self) -> list[tuple[Effect, IntArray]]:
        """Each effect of the base model and its RIRs."""
        rirs: dict[Effect, list[int]] = {}
        for n, effects in enumerate(self.given):
            for effect in effects:
                rirs.setdefault(effect, []).append(n)
        return [(effect, np.array(of_effect)) for effect, of_effect in rirs.items()]

    @property
    def given_kinds(self) -> set[type[Effect]]:
        """Types of the effects that the base model has."""
        return {type(effect) for effect, _ in self.given_to}

    @property
    def noise_db(self) -> FloatArray:
        """Noise of each recording (feature "floor"), shape (n_rirs, 22), NaN where it is unknown."""
        at = feature_slice("floor")
        return np.where(self.valid[:, at], self.features[:, at], np.nan)

    @property
    def is_scored(self) -> BoolArray:
        """Whether a room has RIRs of two places or more: one calibrates it, another is scored; shape (n_rooms,)."""
        first_of_place = np.unique(self.place_number, return_index=True)[1]
        return np.bincount(self.room[first_of_place], minlength=len(self.room_names)) > 1

    def residual(self, predicted: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Measured minus predicted features, and which of them are valid, shape (n_rirs, n_features) each.

        An upper limit counts as a measurement where the prediction exceeds it, and says nothing elsewhere.
        """
        residual = self.features - predicted
        return residual, (self.valid | (self.bounded & (residual < 0.0))) & np.isfinite(residual)

    def rendered_change_of(self, effect: type[Effect]) -> FloatArray:
        """Changes that an effect makes to rendered features, shape (n_grid_points, n_rirs, n_features) [JND].

        For effects that cannot be predicted from tables, at each vector of their `INTERPOLATION_GRID`.
        """
        return self.rendered_changes[effect.NAME]

    def units(self, scope: str) -> tuple[list[str], IntArray]:
        """Names of the units of a scope, such as its microphones, and the number of the unit of each RIR."""
        if scope == "all":
            return ["all"], np.zeros(len(self.rows), dtype=int)
        if scope == "rir":
            return [row["id"] for row in self.rows], np.arange(len(self.rows))
        if scope == "axis":
            axes, axis_of_row = np.unique(self.axis, return_inverse=True)
            return [str(axis) for axis in axes], axis_of_row
        return _numbered([unit_name(row, scope) for row in self.rows])


class _Recording(NamedTuple):
    """A row, its directory and its geometry."""

    directory: Path
    row: RirRow
    place: Place


def load_data(usable: UsableRirs, *, scattering: float, seed: int, model: Model | None = None, nj: int = 1) -> Data:
    """Measure usable RIRs and trace their rooms.

    Parameters
    ----------
    usable : UsableRirs
        Of which there is at least one.
    scattering : float
        Scattering coefficient of all surfaces.
    seed : int
    model : Model, optional
        The base model's effects.
    nj : int

    Raises
    ------
    ValueError
        An RIR cannot be measured or simulated; the message names its file.
    """
    located, estimates = complete_geometry(usable.rirs, seed, nj)
    recordings = _share_facings(_merge_sources([
        _Recording(*rir, find_place(rir.row, [rir.row], rir.directory, seed)) for rir in located]))
    for directory, row, place in recordings:
        try:
            check_positions(place.room, place.source_pos_m, place.mic_pos_m)  # here, where the RIR has a name
        except ValueError as error:
            raise ValueError(f"{rir_path(directory, row)}: {error}") from None
    rows, places = [recording.row for recording in recordings], [recording.place for recording in recordings]
    features = limit_to_excitation(rows, share_out(_measure, recordings, nj, label="measure RIRs"))
    traced, path_samples, tables = _trace_sources(rows, places, features, scattering, seed, nj)
    measured = measured_fields(features)
    hidden = ~np.array([table.visible for table in tables])
    if hidden.any():
        logger.info("the source is hidden from the microphone in %d of %d RIRs: their direct sound is not scored",
                    hidden.sum(), len(rows))
        measured["valid"][np.ix_(hidden, np.isin(METRIC, ("direct", "drr", "arrival")))] = False
    room_names, room = _numbered([row["room_id"] for row in rows])
    _, chain = _numbered([(row["room_id"], row["source_id"], row["mic_id"], session_name(row)) for row in rows])
    _, place_number = _numbered([place_key(rir.row) for rir in usable.rirs])
    airs, distance_m = [air_of(row) for row in rows], np.array([table.distance_m for table in tables])
    base = Model() if model is None else model
    return Data(
        rows=rows, places=places, **measured, comparable=comparable_levels(rows, features, distance_m), room=room,
        chain=chain, place_number=place_number, room_names=room_names, traced=traced, path_samples=path_samples,
        tables=tables, surface_per_m=np.array([_surface_per_m(place.room) for place in places]),
        air_per_m=np.array([air.attenuation_per_m for air in airs]),
        speed_m_s=np.array([air.speed_m_s for air in airs]), distance_m=distance_m, rendered_changes={},
        given=[base.for_row(row, seed) for row in rows],
        documented=[rir.row for rir in usable.rirs], estimates=estimates, left_out=usable.left_out)


def _merge_sources(recordings: list[_Recording]) -> list[_Recording]:
    """Move the positions of a source that are closer than `SAME_PLACE_M` to their mean: one trace serves them all.

    A position stays where the mean is closer to its microphone than the simulator allows.
    """
    of_source = numbers_by((row["room_id"], row["source_id"]) for _, row, _ in recordings)
    merged = list(recordings)
    for members in of_source.values():
        positions_m = np.array([recordings[n].place.source_pos_m for n in members])
        places_m, place = np.unique(positions_m, axis=0, return_inverse=True)  # in an order of their own
        # no two of a group are further apart (complete linkage)
        group = (fcluster(linkage(places_m, "complete"), SAME_PLACE_M, "distance") if len(places_m) > 1
                 else np.ones(1))[place.ravel()]
        for n, number in zip(members, group, strict=True):
            mean_m = tuple(float(x) for x in positions_m[group == number].mean(axis=0))
            if not is_too_close(math.dist(mean_m, recordings[n].place.mic_pos_m)):
                merged[n] = recordings[n]._replace(place=replace(recordings[n].place, source_pos_m=mean_m))
    moved_m = [float(np.linalg.norm(np.subtract(after.place.source_pos_m, before.place.source_pos_m)))
               for before, after in zip(recordings, merged, strict=True)]
    if max(moved_m) > _MOVED_M:
        logger.info("the source of %d of %d RIRs is moved by up to %.0f cm: positions of a source closer than %.0f cm "
                    "are taken as one", sum(moved > _MOVED_M for moved in moved_m), len(merged), 100.0 * max(moved_m),
                    100.0 * SAME_PLACE_M)
    return merged


def _share_facings(recordings: list[_Recording]) -> list[_Recording]:
    """Let RIRs that do not state where their source faces take the direction that the others of its position state.

    They must state one direction, and not only that of their own microphones: a source that is turned to each
    microphone faces another way in the other RIRs.
    """
    of_position = numbers_by((row["room_id"], row["source_id"], place.source_pos_m) for _, row, place in recordings)
    shared = list(recordings)
    for members in of_position.values():
        known = {n: unit_facing(recordings[n].row.get("source_dir")) for n in members}
        facings = {n: facing for n, facing in known.items() if facing is not None}
        if not 0 < len(facings) < len(members):
            continue
        axes = np.array([*facings.values()])
        towards = np.array([towards_microphone(recordings[n].place) for n in facings])
        if max(_angles_deg(axes, axes[0])) <= _ONE_FACING_DEG < max(_angles_deg(axes, towards)):
            for n in members:
                if n not in facings:
                    shared[n] = recordings[n]._replace(row={**recordings[n].row, "source_dir": axes[0].tolist()})
    if n_shared := sum(one is not other for one, other in zip(shared, recordings, strict=True)):
        logger.info("%d RIRs do not state where their source faces, and take the direction that others of its position "
                    "state", n_shared)
    return shared


def _angles_deg(axes: FloatArray, others: FloatArray) -> FloatArray:
    """Return the angles between unit vectors, shape (n, 3), and others, shape (n, 3) or (3,) [degrees]."""
    return np.degrees(np.arccos(np.clip(np.sum(axes * others, axis=1), -1.0, 1.0)))


def air_of(row: RirRow) -> Air:
    """Return the declared air of a row."""
    return Air(**stated_air(row))


def _measure(recording: _Recording) -> Features:
    row, place = recording.row, recording.place
    rir = load_rir(recording.directory, row)
    timed = is_timed(row)
    expected = float(np.linalg.norm(np.subtract(place.mic_pos_m, place.source_pos_m))) / air_of(
        row).speed_m_s * FS_HZ if timed else None
    try:
        return measure_features(rir, expected, timed=timed)
    except ValueError as error:
        raise ValueError(f"{recording.directory / row['wav']}: {error}") from None


def measured_fields(features: Sequence[Features]) -> dict[str, Any]:
    """Return the fields of `Data` that hold the features of all RIRs."""
    names = ("valid", "bounded", "white", "direct_sample", "n_samples")
    return dict(features=np.array([of_rir.values for of_rir in features]),
                **{name: np.array([getattr(of_rir, name) for of_rir in features]) for name in names})


def _numbered(names: Sequence[Any]) -> tuple[list[Any], IntArray]:
    """Return the different names in their order, and the number of each name among them."""
    different = sorted(set(names))
    number = {name: n for n, name in enumerate(different)}
    return different, np.array([number[name] for name in names])


def _trace_sources(rows: list[RirRow], places: list[Place], features: list[Features], scattering: float, seed: int,
                   nj: int) -> tuple[list[StoredTrace], list[StoredSample], list[Table]]:
    """Trace each source of each room once; return what RIRs are rendered and predicted from, of each RIR."""
    by_source = numbers_by((row["room_id"], place.source_pos_m, air_of(row))
                           for row, place in zip(rows, places, strict=True))
    file = TraceFile()

    def trace(room_id: str, source_pos_m: tuple, air: Air, members: list[int]
              ) -> tuple[list[StoredTrace], list[StoredSample], list[Table]]:
        room, mics_m = places[members[0]].room, np.array([places[n].mic_pos_m for n in members])
        decays_s = _decays_s([features[n] for n in members]) or _decays_s(
            [of_rir for of_rir, row in zip(features, rows, strict=True) if row["room_id"] == room_id])
        if decays_s is None:
            logger.warning("no decay time of room %s is valid, as recordings are too short or too noisy: rays are "
                           "traced for one of up to %g s", room_id, UNKNOWN_DECAYS_S[1])
            decays_s = UNKNOWN_DECAYS_S
        if decays_s[1] > LENGTHS_S[1]:
            logger.warning("room %s decays for %.1f s, and rays are traced for %g s at most: its late decay is that of "
                           "a shorter one", room_id, decays_s[1], LENGTHS_S[1])
        material = Material("surface", (0.0,) * len(BANDS_HZ), (float(scattering),) * len(BANDS_HZ))
        # twice as long, for octaves without a valid decay time
        expected = uniform_absorption(room, 2.0 * decays_s[1], air.speed_m_s)
        source = trace_source(Scene(room, (material,) * len(room.surfaces), air), source_pos_m, num_rays=NUM_RAYS,
                              max_length_s=_traced_length_s(decays_s[1]),
                              rng=rng_for(seed, "loop trace", repr((room_id, source_pos_m))), absorption=expected)
        facings = [unit_facing(rows[n].get("source_dir")) for n in members]
        samples = draw_path_samples(source, mics_m, decays_s,
                                    [rng_for(seed, "loop paths", rows[n]["id"]) for n in members])
        stored = file.store(source)
        tables = [replace(table, departures=file.store_array(departures)) if facing is None else
                  turned(table, departures, towards_microphone(places[n]), facing)
                  for n, facing, (table, departures) in zip(members, facings, collect(source, mics_m), strict=True)]
        return [stored] * len(members), file.store_samples(samples), tables

    # threads: paths are large, and their kernels release the interpreter's lock
    workers = Parallel(n_jobs=nj, prefer="threads", return_as="generator")
    traces = progress(workers(delayed(trace)(*at, members) for at, members in by_source.items()), len(by_source),
                      "trace sources")
    of_rir = {n: of_member for members, of_source in zip(by_source.values(), traces, strict=True)
              for n, of_member in zip(members, zip(*of_source, strict=True), strict=True)}
    traced, path_samples, tables = zip(*(of_rir[n] for n in range(len(rows))), strict=True)
    return list(traced), list(path_samples), list(tables)


def _decays_s(features: list[Features]) -> tuple[float, float] | None:
    """Return the shortest and the longest valid T20 or T30 of some RIRs, the least length among them [s], or None."""
    least_s, at = LENGTHS_S[0], np.isin(METRIC, ["t20", "t30"])
    times_s = np.exp(DECAY_JND * np.concatenate([of_rir.values[at & of_rir.valid] for of_rir in features]))
    return (float(times_s.min(initial=least_s)), float(times_s.max(initial=least_s))) if len(times_s) else None


def _traced_length_s(decay_s: float) -> float:
    """Return the length to which rays are traced for the longest decay time of a source."""
    return float(np.clip(min(1.2 * decay_s + 0.1, max(decay_s, _MARGIN_TO_S)), *LENGTHS_S))


def _surface_per_m(room: Room) -> FloatArray:
    """Return the area of the walls, and of floor and ceiling, over the volume of a room, shape (2,)."""
    return np.bincount(level_surfaces(room), room.surface_area_m2, minlength=2) / room.volume_m3
