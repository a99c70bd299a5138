"""A loudspeaker that beams: a membrane in a rigid sphere instead of a point (`roomeq.effects.spherical_cap`)."""

from dataclasses import dataclass

import numpy as np

from roomeq.effects.base import Effect
from roomeq.effects.spherical_cap import cap_gain

_RADII_M = (0.005, 0.45)
_CAPS_RAD = (0.1, 1.5)


@dataclass(frozen=True)
class SourceDirectivity(Effect):
    """Of one `source_id`, relative to its axis.

    Attributes
    ----------
    radius_m : float
        Of the sphere: where the cabinet begins to cast a shadow.
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
    def applies(cls, data):
        return any(row.get("source_dir") and None not in row["source_dir"] for row in data.rows)

    def vector(self):
        return np.log([self.radius_m, self.cap_rad])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.exp(np.clip(vector[0], *np.log(_RADII_M)))),
                   float(np.exp(np.clip(vector[1], *np.log(_CAPS_RAD)))))

    def apply_to_prediction(self, state, data, rows):
        gains = self.on_paths(np.cos(data.angles))
        direct = self.on_paths(np.cos([data.tables[n].direct_angle for n in rows]))
        knows = np.array([data.tables[n].angular is not None for n in rows])
        state.apply_directivity(rows[knows], gains, direct[knows])

    def on_paths(self, cos_angle):
        return cap_gain(np.clip(cos_angle, -1.0, 1.0), self.radius_m, self.cap_rad)
