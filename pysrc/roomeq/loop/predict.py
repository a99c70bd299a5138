"""Predicted features of every RIR from tables of ray contributions: the effect of a parameter, without rendering.

A `PredictionState` holds the assumptions: absorption and air, and what effects change. Only differences between two
states are used, added to features that were measured on rendered RIRs. What windows and filters do to a feature is
then part of both.
"""

from collections.abc import Sequence
from copy import copy
from functools import partial
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.decibels import FLOOR_POWER, power_db
from roomeq.acoustics.octaves import OCTAVE_OF_THIRD, OCTAVE_WIDTH_HZ, SPECTRUM_HZ, THIRDS_HZ
from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.core.jit import compiled
from roomeq.effects.noise_floor import SHARE_OF_THIRD
from roomeq.effects.prediction import PredictionState
from roomeq.effects.response import RESPONSE_HZ
from roomeq.loop.data import Data
from roomeq.loop.features import (
    BAND_HZ,
    BAND_OF_FEATURE,
    DIRECT_S,
    DIRECT_THIRDS_HZ,
    EARLY_S,
    JND,
    LATE_S,
    METRIC,
    N_FEATURES,
    QUIET,
    feature_slice,
)
from roomeq.loop.ray_energy import RayEnergy, same, sum_rays
from roomeq.loop.tables import FRAME_EDGES_S
from roomeq.sim.scene import eyring_area_of_mean, time_of_area_s

N_BANDS = len(EXACT_BANDS_HZ)
_db = partial(power_db, floor=FLOOR_POWER)
_DB = 10.0 / np.log(10.0)
_N_DIRECT = len(DIRECT_THIRDS_HZ)
_GATE_FADE_S = 5e-4
"""Time in which the gate of the direct sound closes."""
_GATE_LEAK = 10.0 ** -2.5
"""Share of a direct sound after the end of its gate that is measured in it: filters spread it and what is about it. So
the predicted level is within 3 dB (median) of that of 36 renderings of three rooms, at detours from 1 to 3 m."""
_PULSE_S = np.minimum(1.0 / OCTAVE_WIDTH_HZ, 0.9 * FRAME_EDGES_S[1])
"""Time in which the direct sound passes an octave filter, shape (8,); at low frequencies limited to the first frame."""


def _octaves_to(frequencies_hz: tuple[float, ...]) -> FloatArray:
    """Matrix of linear interpolation over log frequency from the octave bands, shape (n, 8)."""
    position = np.clip(np.interp(np.log(frequencies_hz), np.log(EXACT_BANDS_HZ), np.arange(N_BANDS)), 0, N_BANDS - 1)
    return np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(N_BANDS)))


TO_THIRDS = _octaves_to(SPECTRUM_HZ)
_RESPONSE_TO_OCTAVES = np.array([np.abs(np.log2(np.array(RESPONSE_HZ) / band_hz)) < 0.4 for band_hz in EXACT_BANDS_HZ])
RESPONSE_TO_OCTAVES = _RESPONSE_TO_OCTAVES / _RESPONSE_TO_OCTAVES.sum(axis=1, keepdims=True)
"""Mean of the third octaves of each octave, shape (8, 26)."""
_THIRDS_TO_OCTAVES = _RESPONSE_TO_OCTAVES[:, :len(SPECTRUM_HZ)]
_THIRDS_TO_OCTAVES = _THIRDS_TO_OCTAVES / _THIRDS_TO_OCTAVES.sum(axis=1, keepdims=True)


def base_state(data: Data, absorption: FloatArray) -> PredictionState:
    """Return the state of the base model: the declared air, and the effects of the model that the loop began with.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    """
    n = len(data.rows)
    state = PredictionState(
        absorption=absorption[data.room], air_per_m=data.air_per_m.copy(), speed_m_s=data.speed_m_s.copy(),
        ray_gain=None, reflected_gain=None, direct_gain=np.ones((n, N_BANDS)),
        direct_thirds=np.ones((n, len(SPECTRUM_HZ))), decays=[], response_db=np.zeros((n, len(RESPONSE_HZ))),
        floor=np.zeros((n, len(THIRDS_HZ))), delay_s=np.zeros(n),
        direct_angle=np.array([table.direct_angle for table in data.tables]), rendered_change=np.zeros((n, N_FEATURES)))
    for effect, rows in data.given_to:
        effect.apply_to_prediction(state, data, rows)
    return state


def _reflected_energy(data: Data, state: PredictionState, rays: RayEnergy, kept: FloatArray) -> FloatArray:
    """Return the energy of all but the direct sound, shape (n_rirs, n_frames, 8), of which the air has `kept` a share.

    Frames are lengths of paths, given in seconds at the declared speed of sound.
    """
    edges_s, energy = data.frame_edges_s, rays.at(state) * kept
    if not state.decays:
        return energy
    whole, t60_s = energy.sum(axis=1), _eyring_times_s(data, state)
    for decay, rows in state.decays:
        air = state.speed_m_s[rows][:, None], state.air_per_m[rows]
        rate = decay.rate_per_s(*air) * (data.speed_m_s / state.speed_m_s)[rows][:, None]
        left = np.exp(-edges_s[:, None] * rate[:, None, :])
        energy[rows] += (decay.energy_ratio(t60_s[rows], *air) * whole[rows])[:, None, :] * (left[:, :-1] - left[:, 1:])
    return energy


def _kept_by_air(data: Data, air_per_m: FloatArray) -> FloatArray:
    """Return the share of the energy in each frame that the air does not absorb, shape (n_rirs, n_frames, 8)."""
    middle_s = 0.5 * (data.frame_edges_s[1:] + data.frame_edges_s[:-1])
    length_m = data.distance_m[:, None] + middle_s * data.speed_m_s[:, None]
    return np.exp(-length_m[:, :, None] * air_per_m[:, None, :])


def _eyring_times_s(data: Data, state: PredictionState) -> FloatArray:
    """Return the decay time of each RIR's room by Eyring, shape (n_rirs, 8)."""
    of_room = data.surface_per_m.sum(axis=1, keepdims=True)
    mean = np.einsum("ns,nsb->nb", data.surface_per_m / of_room, -np.expm1(-state.absorption))
    area_per_m3 = eyring_area_of_mean(mean, of_room, state.air_per_m, 1.0)
    return time_of_area_s(area_per_m3, 1.0, state.speed_m_s[:, None])


class ReflectedEnergy:
    """Energy of all but the direct sound, as features need it; states that differ only in other things share it.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    state : PredictionState
    rays : RayEnergy, optional
        Of the state, or of one that differs little in absorption and in directivity (`RayEnergy.at`).
    """

    def __init__(self, data: Data, state: PredictionState, rays: RayEnergy | None = None) -> None:
        self.rays = sum_rays(data, state) if rays is None else rays
        self._data, self._air_per_m, self._kept = data, state.air_per_m, _kept_by_air(data, state.air_per_m)
        self._times_s: FloatArray = np.empty((len(data.rows), 3, N_BANDS))
        self._moved: BoolArray = np.ones(N_BANDS, dtype=bool)  # octaves whose decay times may change
        self._set(state)

    def _set(self, state: PredictionState) -> None:
        self._energy = _reflected_energy(self._data, state, self.rays, self._kept)
        self._gates_s = np.array([seconds * state.speed_m_s / self._data.speed_m_s
                                  for seconds in (DIRECT_S, EARLY_S, LATE_S)])
        self._gain: FloatArray | None = None
        self._levels = levels_until(self._gates_s, self._energy)
        self._direct: FloatArray | None = None

    def moved_to(self, state: PredictionState, bands: Sequence[int] = ()) -> "ReflectedEnergy":
        """Return the energy of a state that differs little in absorption and in directivity (`RayEnergy.at`).

        Where it differs in the octaves `bands` alone, the decay times of others are as computed here before.
        """
        made = self.copy(bands)
        if not same(state.air_per_m, self._air_per_m):
            made._air_per_m, made._kept = state.air_per_m, _kept_by_air(self._data, state.air_per_m)
        made._set(state)
        return made

    def copy(self, bands: Sequence[int] = ()) -> "ReflectedEnergy":
        """Return a copy for a state that differs otherwise; its direct sound does in the octaves `bands` alone."""
        made = copy(self)
        made._times_s = self._times_s.copy()
        made._moved = np.isin(np.arange(N_BANDS), bands) if len(bands) else np.ones(N_BANDS, dtype=bool)
        return made

    def levels(self, gain: FloatArray | None) -> FloatArray:
        """Return the energy until the gates `DIRECT_S`, `EARLY_S`, `LATE_S`, and all, shape (4, n_rirs, 8).

        `gain` is `PredictionState.reflected_gain`.
        """
        if not same(gain, self._gain):
            self._gain, self._direct = gain, None
            self._levels = levels_until(self._gates_s, self._gained())
        return self._levels

    def _gained(self) -> FloatArray:
        return self._energy if self._gain is None else self._energy * self._gain

    def decay_times_s(self, direct: FloatArray, gain: FloatArray | None) -> FloatArray:
        """Return EDT, T20 and T30 after a direct sound of energy `direct`, shape (n_rirs, 8), as (n_rirs, 3, 8)."""
        self.levels(gain)
        if not same(direct, self._direct):
            self._direct, energy = direct, self._gained()
            decay_times(direct, energy, self._data.frame_edges_s, _PULSE_S, self._moved, self._times_s)
        return self._times_s


class Predicted(NamedTuple):
    """Predicted features.

    Attributes
    ----------
    features : ndarray, shape (n_rirs, n_features)
        In JND.
    drr_energy : ndarray, shape (2, n_rirs, 8)
        Energy per band until and after the gate of the DRR, the only feature that depends on all bands.
    """

    features: FloatArray
    drr_energy: FloatArray


DEPENDS_ON_BAND = np.array([TO_THIRDS[SPECTRUM_HZ.index(band_hz)] > 0.0 if metric in ("direct", "spectrum")
                            else np.arange(N_BANDS) == (-9 if metric in ("drr", "arrival") else band)
                            for metric, band_hz, band in zip(METRIC, BAND_HZ, BAND_OF_FEATURE, strict=True)])
"""Whether a feature depends on the energy in an octave, shape (n_features, 8); the DRR depends on all."""
BANDS_APART = 3
"""Bands so far apart share no feature but the DRR."""


def drr(energy: FloatArray) -> FloatArray:
    """Return the feature "drr" from `Predicted.drr_energy`, shape (n_rirs,)."""
    near, far = energy.sum(axis=2)
    return (_db(near) - _db(far)) / JND["drr"]


def predict(data: Data, state: PredictionState, reflected: ReflectedEnergy | None = None) -> FloatArray:
    """Predict the features of every RIR as `predict_by_band` does, shape (n_rirs, n_features)."""
    return predict_by_band(data, state, reflected).features


def predict_by_band(data: Data, state: PredictionState, reflected: ReflectedEnergy | None = None) -> Predicted:
    """Predict the features of every RIR, without the gains of the recordings.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    state : PredictionState
    reflected : ReflectedEnergy, optional
        Of the state, where it is known.
    """
    reflected = ReflectedEnergy(data, state) if reflected is None else reflected
    near, early, late, whole = reflected.levels(state.reflected_gain)
    visible = np.array([table.visible for table in data.tables], dtype=float)
    direct = (visible / (4.0 * np.pi * data.distance_m) ** 2)[:, None] * state.direct_gain * np.exp(
        -data.distance_m[:, None] * state.air_per_m)
    direct_thirds_db = _db(direct) @ TO_THIRDS.T + _db(state.direct_thirds)
    direct = direct * (state.direct_thirds @ _THIRDS_TO_OCTAVES.T)
    near_thirds_db, whole_thirds_db = _db(near) @ TO_THIRDS.T, _db(whole) @ TO_THIRDS.T
    # direct sound that comes around an obstacle after the end of its gate is early sound
    in_gate = np.clip((DIRECT_S - state.delay_s) / _GATE_FADE_S + 0.5, _GATE_LEAK, 1.0)[:, None]
    response_octaves_db = state.response_db @ RESPONSE_TO_OCTAVES.T
    response_thirds_db = state.response_db[:, :len(SPECTRUM_HZ)]
    features = np.zeros((len(direct), N_FEATURES))
    features[:, feature_slice("direct")] = (_sum_db(direct_thirds_db + _db(in_gate), near_thirds_db)
                                            + response_thirds_db)[:, -_N_DIRECT:]
    features[:, feature_slice("early")] = _db(early - near + (1.0 - in_gate) * direct) + response_octaves_db
    features[:, feature_slice("late")] = _db(late - early) + response_octaves_db
    features[:, feature_slice("spectrum")] = _sum_db(direct_thirds_db, whole_thirds_db) + response_thirds_db
    features[:, feature_slice("c50")] = (_db(direct + early) - _db(whole - early)) / JND["c50"]
    weight = OCTAVE_WIDTH_HZ * 10.0 ** (response_octaves_db / 10.0)
    drr_energy = np.stack([(in_gate * direct + near) * weight,
                           (whole - near + (1.0 - in_gate) * direct) * weight])
    features[:, feature_slice("drr")] = drr(drr_energy)[:, None]
    times_s = reflected.decay_times_s(direct, state.reflected_gain)
    log_shortening = np.log(data.speed_m_s / state.speed_m_s)[:, None]
    for k, metric in enumerate(("edt", "t20", "t30")):
        features[:, feature_slice(metric)] = (np.log(times_s[:, k]) + log_shortening) / JND[metric]
    arrival_s = data.distance_m / state.speed_m_s + state.delay_s
    features[:, feature_slice("arrival")] = (arrival_s / JND["arrival"])[:, None]
    white = (data.white + QUIET)[:, OCTAVE_OF_THIRD] * SHARE_OF_THIRD
    features[:, feature_slice("floor")] = _db(1.0 + state.floor / white)
    return Predicted(features + state.rendered_change, drr_energy)


def levels_until(gates_s: FloatArray, energy: FloatArray) -> FloatArray:
    """Sum the energy that arrives until some times at the declared speed, (n_gates, n_rirs), and all energy.

    Returns
    -------
    ndarray, shape (n_gates + 1, n_rirs, 8)
    """
    sums = np.zeros((len(gates_s) + 1, len(energy), N_BANDS))
    _add_until(np.interp(gates_s, FRAME_EDGES_S, np.arange(len(FRAME_EDGES_S))), energy, sums)
    return sums


@compiled
def _add_until(place: FloatArray, energy: FloatArray, sums: FloatArray) -> None:
    """Add the frames up to a `place` among them, shape (n_gates, n_rirs), and all frames to sums; see `levels_until`.
    """
    n_gates, n_rirs = place.shape
    for i in range(n_rirs):
        for frame in range(energy.shape[1]):
            for gate in range(n_gates + 1):
                share = min(max(place[gate, i] - frame, 0.0), 1.0) if gate < n_gates else 1.0
                if share > 0.0:
                    for band in range(energy.shape[2]):
                        sums[gate, i, band] += share * energy[i, frame, band]


def _sum_db(first_db: FloatArray, second_db: FloatArray) -> FloatArray:
    """Level of two sounds together."""
    return _db(10.0 ** (first_db / 10.0) + 10.0 ** (second_db / 10.0))


@compiled
def decay_times(direct: FloatArray, energy: FloatArray, edges_s: FloatArray, pulse_s: FloatArray,
                chosen: BoolArray, times_s: FloatArray) -> None:
    """Compute EDT, T20 and T30 from energies per frame into `times_s`, shape (n_rirs, 3, 8), of `chosen` bands.

    The direct sound, shape (n_rirs, 8), arrives within `pulse_s`, shape (8,), at the beginning of the first frame.
    """
    n_rirs, n_frames, n_bands = energy.shape
    curve, log_curve = np.empty(n_frames + 2), np.empty(n_frames + 2)
    time_s = np.empty(n_frames + 2)
    time_s[0] = 0.0
    for frame in range(1, n_frames + 1):  # an assignment of slices takes seconds to compile
        time_s[frame + 1] = edges_s[frame]
    lowest = 10.0 ** -3.5  # of T30; what is below is not needed
    for i in range(n_rirs):
        for band in range(n_bands):
            if not chosen[band]:
                continue
            total = 0.0
            curve[n_frames + 1] = 1e-30
            for frame in range(n_frames - 1, 0, -1):
                total += energy[i, frame, band]
                curve[frame + 1] = total
            time_s[1] = pulse_s[band]
            curve[1] = total + energy[i, 0, band] * (1.0 - pulse_s[band] / edges_s[1])
            curve[0] = total + energy[i, 0, band] + direct[i, band]
            for node in range(n_frames + 2):
                log_curve[node] = np.log(max(curve[node], 1e-30))
                if curve[node] < lowest * curve[0]:
                    break
            for k in range(3):
                top, bottom = (0.0, -10.0) if k == 0 else ((-5.0, -25.0) if k == 1 else (-5.0, -35.0))
                times_s[i, k, band] = _slope(curve, log_curve, time_s, 10.0 ** (0.1 * top), 10.0 ** (0.1 * bottom))


@compiled
def _slope(curve: FloatArray, log_curve: FloatArray, edges_s: FloatArray, top: float, bottom: float) -> float:
    """Time per 60 dB by regression over the part of a decay curve between two fractions of its start, 24 points [s]."""
    first, last = _crossing(curve, edges_s, top), _crossing(curve, edges_s, bottom)
    n = 24
    sum_ty, sum_tt, frame = 0.0, 0.0, 0
    for k in range(n):
        time = first + (last - first) * (k + 0.5) / n
        while frame + 2 < len(curve) and edges_s[frame + 1] < time:
            frame += 1
        part = (time - edges_s[frame]) / (edges_s[frame + 1] - edges_s[frame])
        level = _DB * (log_curve[frame] * (1.0 - part) + log_curve[frame + 1] * part)
        centred = time - 0.5 * (first + last)
        sum_ty += centred * level
        sum_tt += centred * centred
    return max(1e-3, -60.0 / min(sum_ty / max(sum_tt, 1e-12), -1e-3))


@compiled
def _crossing(curve: FloatArray, edges_s: FloatArray, fraction: float) -> float:
    """Time at which a curve has fallen to a fraction of its start, interpolated in dB."""
    level = curve[0] * fraction
    for frame in range(len(curve) - 1):
        if curve[frame + 1] < level:
            high, low = np.log(max(curve[frame], 1e-30)), np.log(max(curve[frame + 1], 1e-30))
            part = 0.0 if high <= low else min(max((high - np.log(level)) / (high - low), 0.0), 1.0)
            return edges_s[frame] + part * (edges_s[frame + 1] - edges_s[frame])
    return edges_s[len(curve) - 1]
