"""Measured RIRs as the loop sees them: their features, who recorded them where, and what rays bring there."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.model import Model
from roomeq.effects.source_directivity import unit_facing
from roomeq.loop.features import JND, feature_slice, measure_features
from roomeq.loop.tables import ANGLES, collect
from roomeq.records.rir_dir import load_rir, read_rirs
from roomeq.sim.geometry import find_place
from roomeq.sim.response import trace_source
from roomeq.sim.scene import Air, Material, Scene

logger = logging.getLogger(__name__)

NUM_RAYS = 5000
SAME_PLACE_M = 0.15
LENGTHS_S = (0.4, 3.0)


@dataclass(frozen=True)
class Data:
    """RIRs of some rooms.

    Attributes
    ----------
    rows : list of dict
        Rows of the RIR directories, sorted by room and id.
    places : list of roomeq.sim.geometry.Place
    features, valid : ndarray, shape (n_rirs, n_features)
        What was measured, and which of it can be believed (`roomeq.loop.features`).
    white : ndarray, shape (n_rirs, 8)
        White noise of the recordings (`roomeq.loop.features.Features`).
    room, chain : ndarray of int, shape (n_rirs,)
        Number of the room, and of the combination of room, source and microphone.
    room_names : list of str
    traced : list of TracedSource
        Of each RIR; shared by the RIRs of one source.
    tables : list of Table
    air_per_m, speed_m_s, distance_m : ndarray, shape (n_rirs, 8), (n_rirs,), (n_rirs,)
        The declared air, and distances between source and microphone.
    rendered_changes : dict
        See `rendered_change_of`.
    given : list of list of roomeq.effects.base.Effect
        Effects of each RIR that the base model has, with their parameters.
    """

    rows: list
    places: list
    features: np.ndarray
    valid: np.ndarray
    white: np.ndarray
    room: np.ndarray
    chain: np.ndarray
    room_names: list
    traced: list
    tables: list
    air_per_m: np.ndarray
    speed_m_s: np.ndarray
    distance_m: np.ndarray
    rendered_changes: dict
    given: list

    angles = ANGLES

    @cached_property
    def given_to(self):
        """Each effect of the base model and its RIRs: list of (effect, ndarray of int)."""
        found = {}
        for n, effects in enumerate(self.given):
            for effect in effects:
                found.setdefault(effect, []).append(n)
        return [(effect, np.array(rows)) for effect, rows in found.items()]

    @property
    def given_kinds(self):
        """Types of the effects that the base model has."""
        return {type(effect) for effect, _ in self.given_to}

    @property
    def n_scored(self):
        """Number of rooms with two RIRs or more: of fewer, none is left to score."""
        return int(np.sum(np.bincount(self.room) > 1))

    def residual(self, predicted):
        """Measured less predicted features, and which of them count, shape (n_rirs, n_features) each."""
        residual = self.features - predicted
        return residual, self.valid & np.isfinite(residual)

    def rendered_change_of(self, effect):
        """What an effect that has no say on tables changes in the features, shape (n_nodes, n_rirs, n_features)."""
        return self.rendered_changes[effect.NAME]

    def units(self, scope):
        """Names of what a parameter of a scope belongs to, and its number for each RIR."""
        if scope == "all":
            return ["all"], np.zeros(len(self.rows), dtype=int)
        if scope == "rir":
            return [row["id"] for row in self.rows], np.arange(len(self.rows))
        key = {"source": "source_id", "mic": "mic_id", "room": "room_id"}[scope]
        names = sorted({row[key] for row in self.rows})
        return names, np.array([names.index(row[key]) for row in self.rows])


def load_data(directories, *, scattering, seed, model=None, nj=1):
    """Read RIR directories, measure their RIRs and trace their rooms.

    Parameters
    ----------
    directories : sequence of Path
        RIR directories (`roomeq.records.rir_dir`). Coordinates that nobody measured are drawn.
    scattering : float
        Scattering coefficient of all surfaces.
    seed : int
    model : roomeq.effects.model.Model, optional
        Effects that the base model has.
    nj : int

    Returns
    -------
    Data

    Raises
    ------
    ValueError
        A directory breaks its contract, an RIR cannot be measured, or two directories share an id.
    """
    found = []
    for directory in map(Path, directories):
        rows = [row for row in read_rirs(directory) if not row.get("noise_for")]
        by_room = {}
        for row in rows:
            by_room.setdefault(row["room_id"], []).append(row)
        found += [(row["room_id"], row["id"], directory, row,
                   find_place(row, by_room[row["room_id"]], directory, seed)) for row in rows]
    found.sort(key=lambda one: one[:2])
    found = _snapped(found)
    _require_unique(found)
    features = share_out(lambda one: _measure(*one[2:]), found, nj)
    return _traced(found, features, scattering, seed, Model() if model is None else model, nj)


def _snapped(found):
    """Give sources of one name that stand closer than they are known to their middle: one trace serves them all."""
    groups = []
    for n, (room_id, _, _, row, place) in enumerate(found):
        for group in groups:
            if group[0] == (room_id, row["source_id"]) and np.linalg.norm(
                    np.subtract(place.source_pos_m, group[1])) < SAME_PLACE_M:
                group[2].append(n)
                break
        else:
            groups.append(((room_id, row["source_id"]), place.source_pos_m, [n]))
    snapped = list(found)
    for _, _, members in groups:
        middle = tuple(float(x) for x in np.mean([found[n][4].source_pos_m for n in members], axis=0))
        for n in members:
            snapped[n] = (*found[n][:4], replace(found[n][4], source_pos_m=middle))
    return snapped


def _require_unique(found):
    first = {}
    for _, rir_id, directory, *_ in found:
        if rir_id in first:
            raise ValueError(f"RIR {rir_id} is in both {first[rir_id]} and {directory}: give each RIR once")
        first[rir_id] = directory


def air_of(row):
    """The declared air of a row."""
    return Air(**{key: row[key] for key in ("temperature_c", "humidity_pct") if row.get(key) is not None})


def is_timed(row):
    """Tell whether sample 0 of an RIR is the emission: only where its row says so."""
    return row.get("tof_removed") is False


def _measure(directory, row, place):
    rir = load_rir(directory, row)
    timed = is_timed(row)
    expected = float(np.linalg.norm(np.subtract(place.mic_pos_m, place.source_pos_m))) / air_of(
        row).speed_m_s * FS_HZ if timed else None
    try:
        return measure_features(rir, expected, timed=timed)
    except ValueError as error:
        raise ValueError(f"{Path(directory) / row['wav']}: {error}") from None


def _traced(found, features, scattering, seed, model, nj):
    rows, places = [one[3] for one in found], [one[4] for one in found]
    room_names = sorted({row["room_id"] for row in rows})
    by_chain = [(row["room_id"], row["source_id"], row["mic_id"]) for row in rows]
    chains = sorted(set(by_chain))
    by_source = {}
    for n, (row, place) in enumerate(zip(rows, places, strict=True)):
        by_source.setdefault((row["room_id"], place.source_pos_m), []).append(n)

    def trace(room_id, source_pos_m, members):
        place = places[members[0]]
        material = Material("surface", 0.0, float(scattering))
        scene = Scene(place.room, [material] * len(place.room.surfaces), air_of(rows[members[0]]))
        length_s = float(np.clip(1.2 * max(_longest_s(features[n]) for n in members) + 0.1, *LENGTHS_S))
        one = trace_source(scene, source_pos_m, num_rays=NUM_RAYS, max_length_s=length_s,
                           rng=rng_for(seed, "loop trace", repr((room_id, source_pos_m))))
        facings = [unit_facing(rows[n].get("source_dir")) for n in members]
        return one, collect(one, [places[n].mic_pos_m for n in members], facings)

    traced, tables = [None] * len(rows), [None] * len(rows)
    # threads: paths are large, and their kernels let go of the interpreter
    made = Parallel(n_jobs=nj, prefer="threads")(delayed(trace)(*at, members) for at, members in by_source.items())
    for members, (one, of_members) in zip(by_source.values(), made, strict=True):
        for n, table in zip(members, of_members, strict=True):
            traced[n], tables[n] = one, table
    airs = [air_of(row) for row in rows]
    return Data(rows=rows, places=places, features=np.array([one.values for one in features]),
                valid=np.array([one.valid for one in features]), white=np.array([one.white for one in features]),
                room=np.array([room_names.index(row["room_id"]) for row in rows]),
                chain=np.array([chains.index(chain) for chain in by_chain]),
                room_names=room_names, traced=traced, tables=tables,
                air_per_m=np.array([air.attenuation_per_m for air in airs]),
                speed_m_s=np.array([air.speed_m_s for air in airs]),
                distance_m=np.array([table.distance_m for table in tables]), rendered_changes={},
                given=[model.for_row(row, seed) for row in rows])


def _longest_s(features):
    """Longest decay time that was measured on an RIR [s]."""
    times = [np.exp(features.values[feature_slice(metric)][features.valid[feature_slice(metric)]] * JND[metric]) for metric in ("t20", "t30")]
    return max([LENGTHS_S[0], *np.concatenate(times)])
