"""The axes of loudspeakers, fitted together with the model.

`roomeq.loop.facing` finds axes with an error of some degrees, for a directivity that is given. A directivity that is
fitted to such axes absorbs a part of their error, so that the same axes are found again; the rest of the error is taken
for an occlusion. Here, axes and directivity are fitted together.

Of the features that show the direct sound, only those take part that are never scored
(`roomeq.loop.features.CALIBRATION_FEATURES`). The features of reflections, which give their level, take part whether
they are scored or not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.effects.base import Effect
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.loop.data import Data
from roomeq.loop.facing import mean_angle_deg, with_facings
from roomeq.loop.features import CALIBRATION_FEATURES, SHOW_DIRECT_SOUND
from roomeq.loop.fit import fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.session import Session
from roomeq.records.schema import unit_name
from roomeq.sim.geometry import towards_microphone

_SD_RAD = 0.15
"""Standard deviation of the error of an axis."""


@dataclass(frozen=True)
class _AzimuthError(Effect):
    """The azimuth error of an axis (`Data.axis`), as far as it changes the direct sound.

    Attributes
    ----------
    angle_rad : float
        Counterclockwise about the vertical.
    """

    angle_rad: float

    NAME = "azimuth_error"
    SCOPE = "axis"
    STARTS = ((0.0,),)
    SPREAD = (_SD_RAD,)
    REFLECTIONS = False

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(float(np.asarray(vector)[0]))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        for n in rows[cast(Data, data).axis[rows] >= 0]:
            axis = _turned(data.rows[n]["source_dir"], self.angle_rad)
            state.direct_angle[n] = np.arccos(np.clip(towards_microphone(data.places[n]) @ axis, -1.0, 1.0))


def _turned(direction: Sequence[float], angle_rad: float) -> FloatArray:
    """Return a direction, shape (3,), turned counterclockwise about the vertical."""
    x, y, z = direction
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def refined_facings(session: Session) -> Data:
    """Return a session's data with axes that are fitted together with the parameters of its model."""
    data = session.data
    turning = np.flatnonzero(data.axis >= 0)
    if not len(turning):
        return data
    shown = replace(data, valid=data.valid & ~(SHOW_DIRECT_SOUND & ~CALIBRATION_FEATURES))
    # the azimuth error comes first, so that the directivity finds the turned axes
    fitted = fit(shown, session.correction, [_AzimuthError, *session.effects], initial=session.fit)
    index = ParameterIndex(shown, fitted.effects)
    angles_rad = index.vectors(fitted.mean, fitted.local)[0][index.shared[0].unit, 0]
    facings = {int(n): _turned(cast(list[float], data.rows[n]["source_dir"]), angles_rad[n]) for n in turning}
    source_of = [unit_name(row, "source") for row in data.rows]
    estimates = []
    for estimate in data.facings:
        of_source = {n: facing for n, facing in facings.items() if source_of[n] == estimate.source}
        estimates.append(replace(estimate, angle_deg=mean_angle_deg(data, of_source)) if of_source else estimate)
    return replace(with_facings(data, facings), facings=tuple(estimates))
