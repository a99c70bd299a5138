"""The quantities that an effect can change in the loop's prediction, and the data it may use to do so.

The loop predicts the features of RIRs from tables of ray contributions (`roomeq.loop.predict`). Effects act on the
assumptions of that prediction, the `PredictionState`: air, directivity, gain and delay of the direct sound, added
energy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.sim.geometry import Place


class DepartureTable(Protocol):
    """The angles of departure in the ray contributions of one RIR (`roomeq.loop.tables.Table`).

    Attributes
    ----------
    angular : ndarray, shape (n, n_angles), or None
        None where it is unknown in which direction the source faces.
    direct_angle : float
        Between the direct sound's departure and the direction that the source faces [rad]; 0 where that is unknown.
    """

    @property
    def angular(self) -> FloatArray | None: ...

    @property
    def direct_angle(self) -> float: ...


class PredictedRirs(Protocol):
    """What effects may know of the RIRs whose features are predicted (`roomeq.loop.data.Data`).

    Attributes
    ----------
    rows : sequence of mapping
        Rows of the RIR directories.
    places : sequence of roomeq.sim.geometry.Place
    tables : sequence of DepartureTable
    angles : ndarray, shape (n_angles,)
        Angles of departure at which `PredictionState.ray_gain` is given [rad].
    distance_m : ndarray, shape (n_rirs,)
        Between source and microphone.
    speed_m_s : ndarray, shape (n_rirs,)
        Declared speed of sound.
    white : ndarray, shape (n_rirs, 8)
        White noise of the recordings: energy of 100 ms relative to the response.
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
    def distance_m(self) -> FloatArray: ...

    @property
    def speed_m_s(self) -> FloatArray: ...

    @property
    def white(self) -> FloatArray: ...

    def rendered_change_of(self, effect: Any) -> FloatArray:
        """Return the rendered change of the features, shape (n_grid_points, n_rirs, n_features) [JND]."""
        ...


class Decay(Protocol):
    """A decay that is added to the reflections (`roomeq.effects.coupled_volume.CoupledVolume`)."""

    @property
    def energy_ratio(self) -> float: ...

    def rate_per_m(self, speed_m_s: FloatArray, attenuation_per_m: FloatArray) -> FloatArray: ...


@dataclass
class PredictionState:
    """The assumptions about each RIR from which its features are predicted.

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
        Further energy gain of the direct sound at `roomeq.acoustics.octaves.THIRDS_HZ`.
    decays : list of (Decay, ndarray of int)
        Added decays, and the RIRs that have them.
    response_db : ndarray, shape (n_rirs, 23)
        Response of the recording chain at `roomeq.effects.response.RESPONSE_HZ`.
    floor : ndarray, shape (n_rirs, 8)
        Energy of 100 ms of noise relative to the response, without the white noise of the recording.
    delay_s : ndarray, shape (n_rirs,)
        Delay of the direct sound.
    rendered_change : ndarray, shape (n_rirs, n_features)
        Change of the features that was measured on renderings [JND].
    """

    absorption: FloatArray
    air_per_m: FloatArray
    speed_m_s: FloatArray
    ray_gain: FloatArray | None
    direct_gain: FloatArray
    direct_thirds: FloatArray
    decays: list[tuple[Decay, IntArray]]
    response_db: FloatArray
    floor: FloatArray
    delay_s: FloatArray
    rendered_change: FloatArray

    def apply_directivity(self, rows: IntArray, gains: FloatArray, direct: FloatArray) -> None:
        """Give sources a directivity.

        Parameters
        ----------
        rows : ndarray of int
        gains : ndarray, shape (n_angles, 8)
            Energy gain of rays at the tables' angles of departure.
        direct : ndarray, shape (n_rows, 8)
            Energy gain of the direct sound.
        """
        if self.ray_gain is None:
            self.ray_gain = np.ones((len(self.direct_gain), *gains.shape))
        self.ray_gain[rows] *= gains
        self.direct_gain[rows] *= direct
