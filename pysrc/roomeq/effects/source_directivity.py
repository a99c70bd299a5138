"""A directive loudspeaker: a membrane in a rigid sphere (`roomeq.effects.spherical_cap`), and deviations from it.

Real cabinets have several membranes, edges and ports. The deviation of each octave is free but smooth over angle and
band: Legendre polynomials of the cosine of the angle, zero on the axis. The sphere is its prior mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import BANDS_HZ
from roomeq.effects.base import Effect, correlation_of_bands
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.effects.spherical_cap import cap_table, look_up, table_angles

_RADII_M = (0.005, 0.45)
_CAPS_RAD = (0.1, 1.5)
_ORDERS = (1, 2, 3)
_N_BANDS = len(BANDS_HZ)
_DEVIATION_DB = np.outer((1.0, 1.0, 0.7), (0.3, 0.3, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0))
"""Standard deviation of each deviation, shape (3, 8): 2.5 dB at the rear; long waves bend around every cabinet."""
_CORRELATION_BANDS, _ROUGH = 1.5, 0.2  # over octaves, and the independent share of the variance
_MAX_DEVIATION_DB = 10.0
_FINE = 16  # angles from one of a grid to the next: 1.4 degrees, finer than any lobe


@dataclass(frozen=True)
class SourceDirectivity(Effect):
    """Directivity of one `source_id`, relative to its axis.

    Attributes
    ----------
    radius_m : float
        Radius of the sphere, which sets the frequency above which the cabinet casts a shadow.
    cap_rad : float
        Half-angle of the membrane.
    deviation_db : tuple of 24 floats
        Coefficient of each Legendre polynomial less its value on the axis: order 1 at eight octaves, then 2 and 3.
    """

    radius_m: float
    cap_rad: float
    deviation_db: tuple[float, ...] = (0.0,) * _DEVIATION_DB.size

    NAME = "source_directivity"
    SCOPE = "source"
    STARTS = tuple((np.log(radius_m), np.log(0.5), *[0.0] * _DEVIATION_DB.size) for radius_m in (0.08, 0.03, 0.2))
    SPREAD = (0.7, 0.5, *_DEVIATION_DB.ravel().tolist())
    BANDS = (None, None, *[band for _ in _ORDERS for band in range(_N_BANDS)])
    DISCRIMINATING_MEASUREMENT = "the loudspeaker turned, at the same place"

    @classmethod
    def prior_covariance(cls) -> FloatArray:
        covariance = np.diag(np.square(np.asarray(cls.SPREAD)))
        smooth = (1.0 - _ROUGH) * correlation_of_bands(_N_BANDS, _CORRELATION_BANDS) + _ROUGH * np.eye(_N_BANDS)
        for n, of_order in enumerate(_DEVIATION_DB):
            at = slice(2 + n * _N_BANDS, 2 + (n + 1) * _N_BANDS)
            covariance[at, at] = np.outer(of_order, of_order) * smooth
        return covariance

    @classmethod
    def applies(cls, data: PredictedRirs) -> bool:
        return any(unit_facing(row.get("source_dir")) is not None for row in data.rows)

    def vector(self) -> FloatArray:
        return np.concatenate([np.log([self.radius_m, self.cap_rad]), self.deviation_db])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.exp(np.clip(vector[0], *np.log(_RADII_M)))),
                   float(np.exp(np.clip(vector[1], *np.log(_CAPS_RAD)))),
                   tuple(float(x) for x in np.clip(vector[2:], -_MAX_DEVIATION_DB, _MAX_DEVIATION_DB)))

    def on_paths(self, cos_angle: FloatArray) -> FloatArray:
        return look_up(cos_angle, _gain_table(self))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        rows = rows[[data.tables[n].angular is not None for n in rows]]
        direct = self.on_paths(np.cos(state.direct_angle[rows]))
        state.apply_directivity(rows, _ray_gains(self, tuple(data.angles)), direct)


@lru_cache(maxsize=256)
def _gain_table(directivity: SourceDirectivity) -> FloatArray:
    """Return the energy gain at the angles of a table (`cap_table`), shape (n_angles, 8)."""
    of_cap = cap_table(directivity.radius_m, directivity.cap_rad)
    shapes_db = np.reshape(directivity.deviation_db, _DEVIATION_DB.shape)
    return of_cap * 10.0 ** (_shapes(len(of_cap)) @ shapes_db / 10.0)


@lru_cache(maxsize=4)
def _shapes(n_angles: int) -> FloatArray:
    """Return the Legendre polynomials of `_ORDERS` less their value on the axis, at the angles of a table, (n, 3)."""
    x = np.cos(table_angles(n_angles))
    return np.stack([x - 1.0, 1.5 * (x ** 2 - 1.0), 2.5 * x ** 3 - 1.5 * x - 1.0], axis=1)


@lru_cache(maxsize=256)
def _ray_gains(directivity: SourceDirectivity, angles: tuple[float, ...]) -> FloatArray:
    """Return the energy gain of rays at the angles of a grid, shape (n_angles, 8); a fit asks for the same again."""
    fine, weights = _neighbourhoods(angles)
    return weights @ directivity.on_paths(np.cos(fine))


@lru_cache(maxsize=2)
def _neighbourhoods(angles: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return fine angles, and their weights in the mean about each angle of a grid, shape (n_angles, n_fine).

    The energy of a ray is shared out to the two angles beside its own, in proportion to its nearness. The mean over the
    sphere with these shares takes the place of the gain at a single angle, which may be a notch of the directivity.
    """
    fine = np.linspace(angles[0], angles[-1], _FINE * (len(angles) - 1) + 1)
    weights = np.array([np.interp(fine, angles, of_angle) for of_angle in np.eye(len(angles))]) * np.sin(fine)
    return fine, weights / weights.sum(axis=1, keepdims=True)


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
