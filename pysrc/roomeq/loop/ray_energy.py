"""Energy of ray contributions over time, and how it changes with absorption and with the directivity of the source.

A table holds contributions by number of reflections and by angle of departure (`roomeq.loop.tables`). One pass over it
gives their sum in each frame, its derivatives by the absorption, and its parts by angle of departure. So a model is
linearized in one pass, and not in one for each parameter.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.core.arrays import Array, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled
from roomeq.effects.prediction import PredictionState
from roomeq.loop.data import Data
from roomeq.loop.tables import ANGLES, LEVEL_SHARES

_N_BANDS = 8
_NO_ANGLES: Array = np.empty((0, 0), np.float32)
_N_SHARES, _N_ANGLES = len(LEVEL_SHARES), len(ANGLES)  # constants to the compiler, which unrolls their loops
_ZEROS: Numbers = (np.float32(0.0),) * 8
_ONES: Numbers = (np.float32(1.0),) * 8
_ONE, _STEP = np.float32(1.0), np.float32(LEVEL_SHARES[1])


@dataclass(frozen=True)
class RayEnergy:
    """Energy of all but the direct sound before air absorption, for one absorption and directivity.

    Attributes
    ----------
    absorption, ray_gain
        As in `PredictionState`.
    energy : ndarray, shape (n_rirs, n_frames, 8)
    by_absorption : ndarray, shape (n_rirs, 2, n_frames, 8)
        What it falls by, per absorption exponent of the walls, and of floor and ceiling; empty unless asked for.
    by_angle : ndarray of float32, shape (n_rirs, n_frames, n_angles, 8)
        Its parts by angle of departure before the directivity, 0 where angles are unknown; empty unless asked for.
    """

    absorption: FloatArray
    ray_gain: FloatArray | None
    energy: FloatArray
    by_absorption: FloatArray
    by_angle: Array

    def at(self, state: PredictionState) -> FloatArray:
        """Return the energy for another absorption, to first order, and another directivity, as `energy`.

        Raises
        ------
        ValueError
            What that needs was not summed (`sum_rays`).
        """
        energy = self.energy
        if not same(state.absorption, self.absorption):
            if self.by_absorption.shape[1] != 2:
                raise ValueError("derivatives by the absorption were not summed")
            step = (state.absorption - self.absorption)[:, :, None, :]
            energy = energy - (self.by_absorption * step).sum(axis=1)
        if state.ray_gain is not None and not same(state.ray_gain, self.ray_gain):
            if self.by_angle.shape[1] != energy.shape[1]:
                raise ValueError("parts by angle of departure were not summed")
            energy = energy.copy()
            add_gain(self.by_angle, state.ray_gain - (1.0 if self.ray_gain is None else self.ray_gain), energy)
        return energy


def same(one: FloatArray | None, other: FloatArray | None) -> bool:
    """Tell whether two arrays, or none, are equal."""
    return one is other or (one is not None and other is not None and np.array_equal(one, other))


def sum_rays(data: Data, state: PredictionState, *, by_absorption: bool = False, by_angle: bool = False) -> RayEnergy:
    """Sum the ray contributions of each RIR over the frames `Data.frame_edges_s`.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    state : PredictionState
        Its absorption and directivity.
    by_absorption, by_angle : bool
        What `RayEnergy` has besides the sum: what `RayEnergy.at` needs of another absorption or directivity.
    """
    # share of the energy that each reflection leaves, shape (n_rirs, n_shares, 8)
    share = LEVEL_SHARES[:, None]
    kept = np.exp(-state.absorption[:, :1] * (1.0 - share) - state.absorption[:, 1:] * share).astype(np.float32)
    gain = None if state.ray_gain is None else state.ray_gain.astype(np.float32)
    n_rirs, n_frames = len(kept), len(data.frame_edges_s) - 1
    energy = np.zeros((n_rirs, n_frames, _N_BANDS))
    slopes = np.zeros((n_rirs, 2 if by_absorption else 0, n_frames, _N_BANDS))
    parts = np.zeros((n_rirs, n_frames if by_angle else 0, _N_ANGLES, _N_BANDS), np.float32)
    for i, table in enumerate(data.tables):
        angular = _NO_ANGLES if table.angular is None else table.angular
        of_angle = _NO_ANGLES if table.angular is None or gain is None else gain[i]
        add_up(table.entries, table.counts, angular, of_angle, kept[i], energy[i], slopes[i], parts[i])
    return RayEnergy(state.absorption, state.ray_gain, energy, slopes, parts)


@compiled
def add_up(entries: IntArray, counts: Array, angular: Array, ray_gain: Array, kept: Array, energy: FloatArray,
           by_absorption: FloatArray, by_angle: Array) -> None:
    """Sum the contributions of a table into the energy per frame, with the loss of each reflection and a directivity.

    Parameters
    ----------
    entries, counts, angular
        As in `roomeq.loop.tables.Table`, sorted by frame; `angular` is empty where it is unknown.
    ray_gain : ndarray of float32, shape (n_angles, 8)
        Empty for an omnidirectional source.
    kept : ndarray of float32, shape (n_shares, 8)
        Share of the energy that each reflection leaves.
    energy, by_absorption, by_angle
        Of one RIR, as in `RayEnergy`; the last two may be empty.
    """
    n_entries, most, k = len(entries), 0, 0
    directive, in_parts = len(ray_gain) > 0, len(by_angle) > 0 and len(angular) > 0
    for entry in range(n_entries):
        most = max(most, entries[entry, 1])
    left = np.empty((most + 1, _N_SHARES, 8), np.float32)  # after each number of reflections
    for node in range(_N_SHARES):
        product, factor = _ONES, _octaves(kept[node])
        for n in range(most + 1):
            _put(left[n, node], product)
            product = _times(product, factor)
    while k < n_entries:
        frame = entries[k, 0]
        total, of_walls, of_level = _ZEROS, _ZEROS, _ZEROS
        while k < n_entries and entries[k, 0] == frame:
            n = entries[k, 1]
            amount, gain = _ZEROS, _ZEROS if directive else _ONES
            for node in range(_N_SHARES):  # many are 0; a branch would take longer
                amount = _plus(amount, counts[k, node], _octaves(left[n, node]))
            if directive:
                for angle in range(_N_ANGLES):
                    gain = _plus(gain, angular[k, angle], _octaves(ray_gain[angle]))
            arriving = _times(amount, gain)
            total = _plus(total, _ONE, arriving)
            if len(by_absorption):
                level = _ZEROS
                for node in range(1, _N_SHARES):
                    level = _plus(level, counts[k, node] * (_STEP * np.float32(node)), _octaves(left[n, node]))
                level = _times(level, gain)
                of_walls = _plus(_plus(of_walls, np.float32(n), arriving), -np.float32(n), level)
                of_level = _plus(of_level, np.float32(n), level)
            if in_parts:
                for angle in range(_N_ANGLES):
                    part = by_angle[frame, angle]
                    _put(part, _plus(_octaves(part), angular[k, angle], amount))
            k += 1
        _put(energy[frame], total)
        if len(by_absorption):
            _put(by_absorption[0, frame], of_walls)
            _put(by_absorption[1, frame], of_level)


@compiled
def add_gain(by_angle: Array, gain: FloatArray, energy: FloatArray) -> None:
    """Add parts by angle of departure times their gain, shape (n_rirs, n_angles, 8), to the energies of RIRs."""
    for i in range(len(by_angle)):
        for frame in range(by_angle.shape[1]):
            total = _octaves(energy[i, frame])
            for angle in range(_N_ANGLES):
                total = _plus(total, 1.0, _times(_octaves(by_angle[i, frame, angle]), _octaves(gain[i, angle])))
            _put(energy[i, frame], total)


# eight bands are eight variables, which stay in registers
@compiled
def _octaves(row: Array) -> Numbers:
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]


@compiled
def _put(row: Array, octaves: Numbers) -> None:
    row[0], row[1], row[2], row[3] = octaves[0], octaves[1], octaves[2], octaves[3]
    row[4], row[5], row[6], row[7] = octaves[4], octaves[5], octaves[6], octaves[7]


@compiled
def _plus(total: Numbers, weight: Number, other: Numbers) -> Numbers:
    return (total[0] + weight * other[0], total[1] + weight * other[1], total[2] + weight * other[2],
            total[3] + weight * other[3], total[4] + weight * other[4], total[5] + weight * other[5],
            total[6] + weight * other[6], total[7] + weight * other[7])


@compiled
def _times(one: Numbers, other: Numbers) -> Numbers:
    return (one[0] * other[0], one[1] * other[1], one[2] * other[2], one[3] * other[3], one[4] * other[4],
            one[5] * other[5], one[6] * other[6], one[7] * other[7])
