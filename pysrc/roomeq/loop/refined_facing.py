"""The axes of loudspeakers, refined together with the model.

`roomeq.loop.facing` finds axes to some degrees, with a directivity that is given. One that was fitted to such axes
hides their errors, which then look like obstacles ahead of single microphones. Here, both are fitted together.
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
from roomeq.loop.facing import mean_angle_deg, towards_microphones, with_facings
from roomeq.loop.features import CALIBRATION_FEATURES, METRIC
from roomeq.loop.fit import fit
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.session import Session
from roomeq.records.schema import unit_name

_SD_RAD = 0.15
"""Standard deviation of the error of an axis before it is refined."""
_SHOW_DIRECT_SOUND = np.isin(METRIC, ("direct", "spectrum", "c50", "drr", "edt"))


@dataclass(frozen=True)
class _Turn(Effect):
    """A turn of the axis that some RIRs share (`Data.axis`), as far as it changes the direct sound.

    Attributes
    ----------
    angle_rad : float
        Counterclockwise about the vertical.
    """

    angle_rad: float

    NAME = "turn"
    SCOPE = "axis"
    STARTS = ((0.0,),)
    SPREAD = (_SD_RAD,)
    REFLECTIONS = False

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(float(np.asarray(vector)[0]))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        data = cast(Data, data)
        towards = towards_microphones(data)
        for n in rows[data.axis[rows] >= 0]:
            axis = _turned(cast(list[float], data.rows[n]["source_dir"]), self.angle_rad)
            state.direct_angle[n] = np.arccos(np.clip(towards[n] @ axis, -1.0, 1.0))


def _turned(direction: Sequence[float], angle_rad: float) -> FloatArray:
    """Return a direction, shape (3,), turned counterclockwise about the vertical."""
    x, y, z = direction
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def with_refined_facings(session: Session) -> Session:
    """Return a session whose estimated axes are fitted together with the parameters of its model.

    Of the features that show the direct sound, only those take part that are never scored.
    """
    data = session.data
    turning = np.flatnonzero(data.axis >= 0)
    if not len(turning):
        return session
    shown = replace(data, valid=data.valid & ~(_SHOW_DIRECT_SOUND & ~CALIBRATION_FEATURES))
    # first, so that the directivity finds the turned axes
    fitted = fit(shown, session.correction, [_Turn, *session.effects], initial=session.fit, threads=session.nj)
    index = ParameterIndex(shown, fitted.effects)
    angles_rad = index.vectors(fitted.mean, fitted.local)[0][index.shared[0].unit, 0]
    facings = {int(n): _turned(cast(list[float], data.rows[n]["source_dir"]), angles_rad[n]) for n in turning}
    source_of = [unit_name(row, "source") for row in data.rows]
    estimates = []
    for estimate in data.facings:
        of_source = {n: facing for n, facing in facings.items() if source_of[n] == estimate.source}
        estimates.append(replace(estimate, angle_deg=mean_angle_deg(data, of_source)) if of_source else estimate)
    return replace(session, data=replace(with_facings(data, facings), facings=tuple(estimates)))
