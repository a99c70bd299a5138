"""Sub-band EQ of measured and simulated RIRs: its distribution, compensation filters, distances between sets."""

from roomeq.eq.compensation import compensate, compensate_rir
from roomeq.eq.distance import eq_distance
from roomeq.eq.fit import fit_eq

__all__ = ["compensate", "compensate_rir", "eq_distance", "fit_eq"]
