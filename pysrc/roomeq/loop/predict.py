"""Expected features of every RIR from tables of energy: what a parameter changes, without rendering.

A `State` says what is assumed: absorption and air, and what effects changed. Only differences between two states are
used, added to features measured on rendered RIRs: what windows and filters do to a feature is then in both.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.core.jit import compiled
from roomeq.effects.response import RESPONSE_HZ
from roomeq.loop.features import (
    BAND_HZ,
    DIRECT_S,
    DIRECT_THIRDS_HZ,
    EARLY_S,
    JND,
    LATE_S,
    N_FEATURES,
    OCTAVE_WIDTH_HZ,
    QUIET,
    THIRDS_HZ,
    feature_slice,
)
from roomeq.loop.tables import FRAME_EDGES_S, LEVEL_SHARES

N_BANDS = len(EXACT_BANDS_HZ)
_N_DIRECT = len(DIRECT_THIRDS_HZ)
_FRAME_MID_S = 0.5 * (FRAME_EDGES_S[1:] + FRAME_EDGES_S[:-1])


def _octaves_to(frequencies_hz):
    """Matrix of linear interpolation over log frequency from the octave bands, shape (n, 8)."""
    position = np.clip(np.interp(np.log(frequencies_hz), np.log(EXACT_BANDS_HZ), np.arange(N_BANDS)), 0, N_BANDS - 1)
    return np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(N_BANDS)))


_ALIKE = np.empty((0, 0))  # in place of angles and their gains
TO_THIRDS = _octaves_to(THIRDS_HZ)
_RESPONSE_TO_OCTAVES = np.array([np.abs(np.log2(np.array(RESPONSE_HZ) / band_hz)) < 0.4 for band_hz in EXACT_BANDS_HZ])
RESPONSE_TO_OCTAVES = _RESPONSE_TO_OCTAVES / _RESPONSE_TO_OCTAVES.sum(axis=1, keepdims=True)
"""Mean of the third octaves of each octave, shape (8, 23)."""


@dataclass
class State:
    """What is assumed of each RIR.

    Attributes
    ----------
    absorption : ndarray, shape (n_rirs, 2, 8)
        ``-ln(1 - alpha)`` of the room's walls, and of its floor and ceiling.
    air_per_m : ndarray, shape (n_rirs, 8)
        Energy attenuation of the air [1/m].
    speed_m_s : ndarray, shape (n_rirs,)
    ray_gain : ndarray, shape (n_rirs, n_angles, 8), or None
        Energy gain of rays over their angle of departure.
    direct_gain : ndarray, shape (n_rirs, 8)
        Energy gain of the direct sound.
    direct_thirds : ndarray, shape (n_rirs, 22)
        The same in third octaves, times `direct_gain`.
    decays : list of (ndarray of int, float, float)
        RIRs with energy that arrives besides: its share of that of all reflections, and how fast it decays [1/s].
    response_db : ndarray, shape (n_rirs, 23)
        Of the recording chain at `RESPONSE_HZ`.
    floor : ndarray, shape (n_rirs, 8)
        Energy of 100 ms of noise relative to the response, white noise of the recording left out.
    delay_s : ndarray, shape (n_rirs,)
        By which the direct sound comes late.
    rendered_change : ndarray, shape (n_rirs, n_features)
        Added to the features [JND].
    """

    absorption: np.ndarray
    air_per_m: np.ndarray
    speed_m_s: np.ndarray
    ray_gain: np.ndarray | None
    direct_gain: np.ndarray
    direct_thirds: np.ndarray
    decays: list
    response_db: np.ndarray
    floor: np.ndarray
    delay_s: np.ndarray
    rendered_change: np.ndarray

    def apply_directivity(self, rows, gains, direct):
        """Give sources a directivity: gains at the tables' angles, shape (n_angles, 8), and of the direct sound."""
        if self.ray_gain is None:
            self.ray_gain = np.ones((len(self.direct_gain), *gains.shape))
        self.ray_gain[rows] *= gains
        self.direct_gain[rows] *= direct


def base_state(data, absorption):
    """State of the base model: declared air, and what effects it was given.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    """
    n = len(data.rows)
    state = State(absorption=absorption[data.room], air_per_m=data.air_per_m.copy(), speed_m_s=data.speed_m_s.copy(),
                  ray_gain=None, direct_gain=np.ones((n, N_BANDS)), direct_thirds=np.ones((n, len(THIRDS_HZ))),
                  decays=[], response_db=np.zeros((n, len(RESPONSE_HZ))),
                  floor=np.zeros((n, N_BANDS)), delay_s=np.zeros(n), rendered_change=np.zeros((n, N_FEATURES)))
    for effect, rows in data.given_to:
        effect.apply_to_prediction(state, data, rows)
    return state


def reflected_energy(data, state):
    """Energy of all but the direct sound, shape (n_rirs, N_FRAMES, 8)."""
    share = LEVEL_SHARES[:, None]
    kept = np.exp(-state.absorption[:, :1] * (1.0 - share) - state.absorption[:, 1:] * share)  # of a hit, (rirs, 6, 8)
    energy = np.zeros((len(kept), len(_FRAME_MID_S), N_BANDS))
    for i, table in enumerate(data.tables):
        turned = state.ray_gain is not None and table.angular is not None
        _add_up(table.entries, table.counts, table.angular if turned else _ALIKE,
                state.ray_gain[i] if turned else _ALIKE, kept[i], energy[i])
    length_m = data.distance_m[:, None] + _FRAME_MID_S * data.speed_m_s[:, None]
    energy *= np.exp(-length_m[:, :, None] * state.air_per_m[:, None, :])
    whole = energy.sum(axis=1)
    for rows, share, rate_per_s in state.decays:
        # frames are lengths, told in seconds at the declared speed; air shortens the decay
        rate = (rate_per_s / state.speed_m_s[rows][:, None] + state.air_per_m[rows]) * data.speed_m_s[rows][:, None]
        left = np.exp(-FRAME_EDGES_S[:, None] * rate[:, None, :])
        energy[rows] += share * whole[rows][:, None, :] * (left[:, :-1] - left[:, 1:])
    return energy


class Reflected:
    """What features take of the energy of all but the direct sound: the same for states that differ in other things.

    Attributes
    ----------
    near, early, late, whole : ndarray, shape (n_rirs, 8)
        Energy until the gates of the levels, and all.
    """

    def __init__(self, data, state):
        self._energy = reflected_energy(data, state)
        self.near, self.early, self.late = (_until(seconds * state.speed_m_s / data.speed_m_s, self._energy)
                                            for seconds in (DIRECT_S, EARLY_S, LATE_S))
        self.whole = self._energy.sum(axis=1)
        self._direct, self._times = None, np.empty((len(self.whole), 3, N_BANDS))

    def decay_times_s(self, direct):
        """EDT, T20 and T30 behind a direct sound of shape (n_rirs, 8), shape (n_rirs, 3, 8)."""
        if self._direct is None or not np.array_equal(direct, self._direct):
            self._direct = direct
            _decay_times(direct + self._energy[:, 0], self._energy, FRAME_EDGES_S, self._times)
        return self._times


def predict(data, state, reflected=None):
    """Expected features in JND, gains of the recordings left out.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    state : State
    reflected : Reflected, optional
        Of the state, where it is known.

    Returns
    -------
    ndarray, shape (n_rirs, n_features)
    """
    reflected = Reflected(data, state) if reflected is None else reflected
    near, early, late, whole = reflected.near, reflected.early, reflected.late, reflected.whole
    visible = np.array([table.visible for table in data.tables], dtype=float)
    direct = (visible / (4.0 * np.pi * data.distance_m) ** 2)[:, None] * state.direct_gain * np.exp(
        -data.distance_m[:, None] * state.air_per_m)
    thirds_direct = _db(np.maximum(direct, 1e-30)) @ TO_THIRDS.T + _db(state.direct_thirds)
    features = np.zeros((len(direct), N_FEATURES))
    octaves_db = state.response_db @ RESPONSE_TO_OCTAVES.T
    thirds_db = state.response_db[:, :len(THIRDS_HZ)]
    first = _db(near) @ TO_THIRDS.T
    features[:, feature_slice("direct")] = (_sum_db(thirds_direct, first) + thirds_db)[:, -_N_DIRECT:]
    features[:, feature_slice("early")] = _db(early - near) + octaves_db
    features[:, feature_slice("late")] = _db(late - early) + octaves_db
    features[:, feature_slice("spectrum")] = _sum_db(thirds_direct, _db(whole) @ TO_THIRDS.T) + thirds_db
    features[:, feature_slice("c50")] = (_db(direct + early) - _db(whole - early)) / JND["c50"]
    weight = OCTAVE_WIDTH_HZ * 10.0 ** (octaves_db / 10.0)
    ratio_db = _db(((direct + near) * weight).sum(axis=1)) - _db(((whole - near) * weight).sum(axis=1))
    features[:, feature_slice("drr")] = (ratio_db / JND["drr"])[:, None]
    times = reflected.decay_times_s(direct)
    shorter = np.log(data.speed_m_s / state.speed_m_s)[:, None]
    for k, metric in enumerate(("edt", "t20", "t30")):
        features[:, feature_slice(metric)] = (np.log(times[:, k]) + shorter) / JND[metric]
    features[:, feature_slice("arrival")] = ((data.distance_m / state.speed_m_s + state.delay_s) / JND["arrival"])[:, None]
    features[:, feature_slice("floor")] = _db(1.0 + state.floor / (data.white + QUIET))
    return features + state.rendered_change


def _until(seconds, energy):
    """Energy that arrives until then, seconds of shape (n_rirs,) at the declared speed, shape (n_rirs, 8)."""
    place = np.interp(seconds, FRAME_EDGES_S, np.arange(len(FRAME_EDGES_S)))
    share = np.clip(place[:, None] - np.arange(energy.shape[1]), 0.0, 1.0)  # of each frame
    return np.einsum("rf,rfb->rb", share, energy)


def _db(power):
    return 10.0 * np.log10(np.maximum(power, 1e-30))


def _sum_db(one_db, other_db):
    return _db(10.0 ** (one_db / 10.0) + 10.0 ** (other_db / 10.0))


@compiled
def _add_up(entries, counts, angular, ray_gain, kept, energy):
    """Add up what arrives, after `kept` of it is left by each reflection and with the gain of its departure."""
    n_angles, n_shares = angular.shape[1], kept.shape[0]
    left = np.ones((entries[:, 1].max() + 1 if len(entries) else 1, n_shares, 8))
    for n in range(1, len(left)):
        for node in range(n_shares):
            for band in range(8):
                left[n, node, band] = left[n - 1, node, band] * kept[node, band]
    zero, one = (0.0,) * 8, (1.0,) * 8
    for k in range(len(entries)):
        amount, gain = zero, one if n_angles == 0 else zero
        for node in range(n_shares):
            if counts[k, node] > 0.0:
                amount = _plus(amount, counts[k, node], left[entries[k, 1], node])
        for angle in range(n_angles):
            gain = _plus(gain, angular[k, angle], ray_gain[angle])
        row = energy[entries[k, 0]]
        row[0] += amount[0] * gain[0]
        row[1] += amount[1] * gain[1]
        row[2] += amount[2] * gain[2]
        row[3] += amount[3] * gain[3]
        row[4] += amount[4] * gain[4]
        row[5] += amount[5] * gain[5]
        row[6] += amount[6] * gain[6]
        row[7] += amount[7] * gain[7]


@compiled
def _plus(total, weight, row):
    """Eight bands with a weighted row added: eight variables, which stay in registers."""
    return (total[0] + weight * row[0], total[1] + weight * row[1], total[2] + weight * row[2],
            total[3] + weight * row[3], total[4] + weight * row[4], total[5] + weight * row[5],
            total[6] + weight * row[6], total[7] + weight * row[7])


@compiled
def _decay_times(direct, energy, edges_s, times_s):
    """EDT, T20 and T30 from energies per frame, shape (n_rirs, 3, 8)."""
    n_rirs, n_frames, n_bands = energy.shape
    curve, log_curve = np.empty(n_frames + 1), np.empty(n_frames + 1)
    for i in range(n_rirs):
        for band in range(n_bands):
            total = 0.0
            curve[n_frames] = 1e-30
            for frame in range(n_frames - 1, 0, -1):
                total += energy[i, frame, band]
                curve[frame] = total
            curve[0] = total + direct[i, band]
            for frame in range(n_frames + 1):
                log_curve[frame] = np.log10(max(curve[frame], 1e-30))
            for k in range(3):
                top, bottom = (0.0, -10.0) if k == 0 else ((-5.0, -25.0) if k == 1 else (-5.0, -35.0))
                times_s[i, k, band] = _slope(curve, log_curve, edges_s, 10.0 ** (0.1 * top), 10.0 ** (0.1 * bottom))


@compiled
def _slope(curve, log_curve, edges_s, top, bottom):
    """Regression over the part of a decay curve between two fractions of its start, 24 points [s per 60 dB]."""
    first, last = _crossing(curve, edges_s, top), _crossing(curve, edges_s, bottom)
    n = 24
    sum_ty, sum_tt, frame = 0.0, 0.0, 0
    for k in range(n):
        time = first + (last - first) * (k + 0.5) / n
        while frame + 2 < len(curve) and edges_s[frame + 1] < time:
            frame += 1
        part = (time - edges_s[frame]) / (edges_s[frame + 1] - edges_s[frame])
        level = 10.0 * (log_curve[frame] * (1.0 - part) + log_curve[frame + 1] * part)
        centred = time - 0.5 * (first + last)
        sum_ty += centred * level
        sum_tt += centred * centred
    return max(1e-3, -60.0 / min(sum_ty / max(sum_tt, 1e-12), -1e-3))


@compiled
def _crossing(curve, edges_s, fraction):
    """Time at which a curve has fallen to a fraction of its start, interpolated in dB."""
    level = curve[0] * fraction
    for frame in range(len(curve) - 1):
        if curve[frame + 1] < level:
            high, low = np.log(max(curve[frame], 1e-30)), np.log(max(curve[frame + 1], 1e-30))
            part = 0.0 if high <= low else min(max((high - np.log(level)) / (high - low), 0.0), 1.0)
            return edges_s[frame] + part * (edges_s[frame + 1] - edges_s[frame])
    return edges_s[len(curve) - 1]


BAND_OF_FEATURE = np.where(BAND_HZ > 0, np.argmin(np.abs(np.log(np.maximum(BAND_HZ, 1.0)[:, None]
                                                               / np.array(EXACT_BANDS_HZ))), axis=1), -1)
"""Octave band of each feature, -1 for the whole band, shape (n_features,)."""
