"""A directive loudspeaker: a membrane in a rigid sphere instead of a point (`roomeq.effects.spherical_cap`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.effects.base import Effect
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.effects.spherical_cap import cap_gain

_RADII_M = (0.005, 0.45)
_CAPS_RAD = (0.1, 1.5)


@dataclass(frozen=True)
class SourceDirectivity(Effect):
    """Directivity of one `source_id`, relative to its axis.

    Attributes
    ----------
    radius_m : float
        Radius of the sphere, which sets the frequency above which the cabinet casts a shadow.
    cap_rad : float
        Half-angle of the membrane.
    """

    radius_m: float
    cap_rad: float

    NAME = "source_directivity"
    SCOPE = "source"
    STARTS = tuple((np.log(radius_m), np.log(0.5)) for radius_m in (0.08, 0.03, 0.2))
    SPREAD = (0.7, 0.5)
    DISCRIMINATING_MEASUREMENT = "the loudspeaker turned, at the same place"

    @classmethod
    def applies(cls, data: PredictedRirs) -> bool:
        return any(unit_facing(row.get("source_dir")) is not None for row in data.rows)

    def vector(self) -> FloatArray:
        return np.log([self.radius_m, self.cap_rad])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.exp(np.clip(vector[0], *np.log(_RADII_M)))),
                   float(np.exp(np.clip(vector[1], *np.log(_CAPS_RAD)))))

    def on_paths(self, cos_angle: FloatArray) -> FloatArray:
        return cap_gain(np.clip(cos_angle, -1.0, 1.0), self.radius_m, self.cap_rad)

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        direct = self.on_paths(np.cos([data.tables[n].direct_angle for n in rows]))
        knows_facing = np.array([data.tables[n].angular is not None for n in rows])
        state.apply_directivity(rows[knows_facing], self.on_paths(np.cos(data.angles)), direct[knows_facing])


def unit_facing(source_dir: Sequence[float | None] | None) -> FloatArray | None:
    """Return the direction that a source faces as a unit vector, shape (3,), or None where it is unknown.

    Parameters
    ----------
    source_dir : sequence of 3 numbers, or None
        Of a row; unknown coordinates are None.
    """
    if source_dir is None or None in source_dir:
        return None
    facing = np.array(source_dir, dtype=float)
    return facing / np.linalg.norm(facing) if np.any(facing) else None
