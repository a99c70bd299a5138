"""The input quantities of the loop's prediction that an effect can change, and the data that the effect may use.

The loop predicts the features of RIRs from tables of ray contributions (`roomeq.loop.predict`). Effects change the
inputs of that prediction, the `PredictionState`: air, directivity, gain and delay of the direct sound, added decays
and noise, response of the recording chain.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.sim.geometry import Place


class DepartureTable(Protocol):
    """The angles of departure in the ray contributions of one RIR (`roomeq.loop.tables.Table`).

    Attributes
    ----------
    visible : bool
        Whether the direct sound arrives in the room without effects.
    angular : ndarray, shape (n, n_angles), or None
        Share of each entry's energy that departs at each angle; None if the orientation of the source is unknown.
    direct_angle : float
        Angle between the direct sound's direction of departure and the source's axis [rad]; 0 if the orientation of the
        source is unknown.
    """

    @property
    def visible(self) -> bool: ...

    @property
    def angular(self) -> FloatArray | None: ...

    @property
    def direct_angle(self) -> float: ...


class PredictedRirs(Protocol):
    """Data of the RIRs whose features are predicted, as far as effects may use it (`roomeq.loop.data.Data`).

    Attributes
    ----------
    rows : sequence of mapping
        Record of each RIR in its directory (a line of `rirs.jsonl`).
    places : sequence of roomeq.sim.geometry.Place
        Room and positions of each RIR.
    tables : sequence of DepartureTable
        Angles of departure of each RIR.
    angles : ndarray, shape (n_angles,)
        Angles of departure at which `PredictionState.ray_gain` is given [rad].
    frame_mid_s : ndarray, shape (n_frames,)
        Middle of each frame of the reflected energy after the direct sound, at the declared speed of sound.
    distance_m : ndarray, shape (n_rirs,)
        Distance between source and microphone.
    speed_m_s : ndarray, shape (n_rirs,)
        Speed of sound at the temperature in each RIR's row.
    white : ndarray, shape (n_rirs, 8)
        White noise of each recording: energy of 100 ms relative to the response, per octave.
    room : ndarray of int, shape (n_rirs,)
        Number of the room of each RIR.
    noise_db : ndarray, shape (n_rirs, 22)
        Noise of each recording in third octaves relative to its white noise, which counts as -55 dB per octave at
        least; NaN where unknown.
    """

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]: ...

    @property
    def places(self) -> Sequence[Place]: ...

    @property
    def tables(self) -> Sequence[DepartureTable]: ...

    @property
    def angles(self) -> FloatArray: ...

    @property
    def frame_mid_s(self) -> FloatArray: ...

    @property
    def distance_m(self) -> FloatArray: ...

    @property
    def speed_m_s(self) -> FloatArray: ...

    @property
    def white(self) -> FloatArray: ...

    @property
    def room(self) -> IntArray: ...

    @property
    def noise_db(self) -> FloatArray: ...

    def rendered_change_of(self, effect: Any) -> FloatArray:
        """Return the change of the features that an effect causes in renderings [JND].

        The shape is (n_grid_points, n_rirs, n_features); the grid is `Effect.INTERPOLATION_GRID`.
        """
        ...


class AddedDecay(Protocol):
    """An exponential decay that is added to the reflections (`roomeq.effects.coupled_volume.CoupledVolume`)."""

    def energy_ratio(self, t60_s: FloatArray, speed_m_s: FloatArray, attenuation_per_m: FloatArray) -> FloatArray:
        """Return the energy of the added decay relative to that of all reflections in a room that decays in `t60_s`."""
        ...

    def rate_per_s(self, speed_m_s: FloatArray, attenuation_per_m: FloatArray) -> FloatArray:
        """Return the rate at which the energy decays [1/s]."""
        ...


@dataclass
class PredictionState:
    """The quantities of each RIR from which its features are predicted.

    Attributes
    ----------
    absorption : ndarray, shape (n_rirs, 2, 8)
        Absorption exponent ``-ln(1 - alpha)`` per octave: of the walls, and of floor and ceiling.
    air_per_m : ndarray, shape (n_rirs, 8)
        Energy attenuation of the air per octave [1/m].
    speed_m_s : ndarray, shape (n_rirs,)
        Speed of sound.
    ray_gain : ndarray, shape (n_rirs, n_angles, 8), or None
        Energy gain of rays per angle of departure and octave; None for an omnidirectional source.
    reflected_gain : ndarray, shape (n_rirs, n_frames, 8), or None
        Energy gain of all reflections per frame and octave; None for 1.
    direct_gain : ndarray, shape (n_rirs, 8)
        Energy gain of the direct sound per octave.
    direct_thirds : ndarray, shape (n_rirs, 25)
        Energy gain of the direct sound per third octave (`roomeq.acoustics.octaves.SPECTRUM_HZ`), multiplied with
        `direct_gain`.
    decays : list of (AddedDecay, ndarray of int)
        Each added decay, and the indices of the RIRs that have it.
    response_db : ndarray, shape (n_rirs, 26)
        Magnitude response of the recording chain [dB] at `roomeq.effects.response.RESPONSE_HZ`.
    floor : ndarray, shape (n_rirs, 22)
        Noise floor: energy of 100 ms of noise in third octaves relative to the response in their octave, without the
        recording's white noise.
    delay_s : ndarray, shape (n_rirs,)
        Delay of the direct sound by obstacles or other effects [s].
    direct_angle : ndarray, shape (n_rirs,)
        Angle between the direct sound's direction of departure and the source's axis [rad]; 0 where the axis is
        unknown.
    rendered_change : ndarray, shape (n_rirs, n_features)
        Change of the features, taken from renderings with and without an effect [JND].
    """

    absorption: FloatArray
    air_per_m: FloatArray
    speed_m_s: FloatArray
    ray_gain: FloatArray | None
    reflected_gain: FloatArray | None
    direct_gain: FloatArray
    direct_thirds: FloatArray
    decays: list[tuple[AddedDecay, IntArray]]
    response_db: FloatArray
    floor: FloatArray
    delay_s: FloatArray
    direct_angle: FloatArray
    rendered_change: FloatArray

    def copy(self) -> "PredictionState":
        """Return a state that effects can change without changing this one."""
        made = copy(self)
        for name, value in vars(self).items():
            if value is not None:
                setattr(made, name, value.copy())
        return made

    def apply_directivity(self, rows: IntArray, gains: FloatArray, direct: FloatArray) -> None:
        """Apply the directivity of the source to some RIRs, in place.

        Parameters
        ----------
        rows : ndarray of int, shape (n_rows,)
            Indices of the RIRs.
        gains : ndarray, shape (n_angles, 8)
            Energy gain of rays at the angles of departure `PredictedRirs.angles`.
        direct : ndarray, shape (n_rows, 8)
            Energy gain of the direct sound.
        """
        if self.ray_gain is None:
            self.ray_gain = np.ones((len(self.direct_gain), *gains.shape))
        self.ray_gain[rows] *= gains
        self.direct_gain[rows] *= direct

    def shade_reflections(self, rows: IntArray, gains: FloatArray) -> None:
        """Apply an energy gain per frame and octave to the reflections of some RIRs, in place.

        Parameters
        ----------
        rows : ndarray of int, shape (n_rows,)
        gains : ndarray, shape (n_rows, n_frames, 8)
        """
        if self.reflected_gain is None:
            self.reflected_gain = np.ones((len(self.direct_gain), *gains.shape[1:]))
        self.reflected_gain[rows] *= gains
