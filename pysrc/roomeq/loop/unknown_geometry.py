"""The unknown geometry of a room: its priors, its likelihood and samples of its posterior.

Unknown are the dimensions of the room (curtains, suspended ceilings), the speed of sound, the latency of recordings
whose rows say that sample 0 is the emission, the probability that a reflection at each wall is heard, and the heights
of sources and microphones. Errors of horizontal positions, of some centimetres, are part of the spread of arrivals. The
posterior follows from the arrivals of all RIRs of the room (`roomeq.loop.arrivals`; Dokmanic et al., PNAS 110 (2013)
12186, and Di Carlo et al., EURASIP J. Audio Speech Music Process. 2021:39, estimate rooms from such arrivals) and is
sampled by sequential Monte Carlo (`roomeq.loop.annealing`).

The arrivals do not change if all heights are mirrored at half the height of the room, nor, with one source and one
microphone height, if these are exchanged: only the prior distinguishes such geometries, and the spread of the posterior
includes them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.jit import compiled
from roomeq.core.rng import rng_for
from roomeq.loop.annealing import Block, anneal
from roomeq.loop.arrivals import Arrivals, early_images, heard_probability, log_likelihood
from roomeq.records.geometry import DEVICES
from roomeq.records.schema import RirRow, is_timed
from roomeq.sim.scene import MIN_WALL_DISTANCE_M, WALLS

N_PARTICLES = 400
INDEPENDENT = 0.6
"""Share of the log-likelihood of arrivals that counts: neighbouring samples and RIRs are not independent, and furniture
reflects as well. With this value the stated intervals hold in a real room of known geometry."""
HEIGHT_M = (1.3, 0.35)
"""Mean and standard deviation of the prior of a source's or microphone's height: tables, seated and standing people."""
DIMENSION_SD_M = (0.15, 0.15, 0.2)
"""Of a documented length, width and height: walls and ceilings are lined."""
DOCUMENTED_HEIGHT_SD_M = 0.1
"""Of a documented height of a source or microphone."""
KEPT_SD_M = 0.01
"""Of a length that is as documented."""
SPEED_SD = 0.006
"""Of the speed of sound, relative: 3.5 degrees."""
LATENCY_SD_MS = 0.5
DIRECT_SD_MS, DIRECT_OUTLIERS = 0.1, 0.05
"""Of the time of the direct sound, and the share of RIRs in which it is obstructed."""
CLEARANCE_M = 0.05
"""Of heights from floor and ceiling."""
HEARD = (0.02, 0.98)
"""Limits of the probability that a reflection at a wall is heard, evenly distributed between them."""

HEIGHT_OF = "height of "
"""Begins the name of the height of a device."""
SPEED, LATENCY, N_SHARED = 3, 4, 11
DIMS, _HEARD = slice(0, 3), slice(5, N_SHARED)
_FLOOR, _CEILING = 5 + WALLS.index("floor"), 5 + WALLS.index("ceiling")


@dataclass(frozen=True)
class Unknown:
    """An unknown quantity; its unit is empty where it is of no interest by itself.

    Attributes
    ----------
    quantity, unit : str
    mean, sd : float
        Of the Gaussian prior.
    documented : float or None
    """

    quantity: str
    unit: str
    mean: float
    sd: float
    documented: float | None = None


class UnknownGeometry:
    """The unknowns of a room: three dimensions, speed of sound, latency, six walls, then heights.

    Parameters
    ----------
    rows : sequence of RirRow
        Rows of one shoebox with the same dimensions; all horizontal coordinates are known.
    arrivals : sequence of Arrivals
        What their RIRs say.
    """

    def __init__(self, rows: Sequence[RirRow], arrivals: Sequence[Arrivals]) -> None:
        self.rows, timed = list(rows), [is_timed(row) for row in rows]
        self._ratio = np.array([of_rir.ratio for of_rir in arrivals])
        self._direct_s = np.array([of_rir.direct_s if is_known else np.nan
                                   for of_rir, is_known in zip(arrivals, timed, strict=True)])
        speed_m_s = np.array([declared_speed_m_s(row) for row in rows])
        self._of_speed = speed_m_s / np.mean(speed_m_s)
        dims_m = [float(size_m) for size_m in cast(list[float], rows[0]["room_dims_m"])]
        self.unknowns = _shared_unknowns(dims_m, float(np.mean(speed_m_s)), any(timed))
        positions: dict[str, list] = {key: [row.get(key) for row in rows] for key in DEVICES}
        self._positions_m = {key: np.array(of_rirs, dtype=float) for key, of_rirs in positions.items()}
        self._height_of = {key: np.zeros(len(rows), dtype=int) for key in DEVICES}
        for key, (kind, id_key) in DEVICES.items():
            documented = [(str(dict(row)[id_key]), of_rir[2]) for row, of_rir in zip(rows, positions[key], strict=True)]
            for name, height_m in dict.fromkeys(documented):
                several = sum(name == other for other, _ in dict.fromkeys(documented)) > 1
                where = f", documented at {height_m} m" if several and height_m is not None else ""
                prior = HEIGHT_M if height_m is None else (float(height_m), DOCUMENTED_HEIGHT_SD_M)
                self._height_of[key][[at == (name, height_m) for at in documented]] = len(self.unknowns)
                self.unknowns.append(Unknown(f"{HEIGHT_OF}{kind} {name}{where}", "m", *prior, height_m))
        self._least_dims_m = MIN_WALL_DISTANCE_M + np.max(
            [np.nan_to_num(positions_m).max(axis=0) for positions_m in self._positions_m.values()], axis=0)
        self._least_dims_m[2] = 2.0 * CLEARANCE_M

    def with_known(self, known_ones: Collection[int]) -> "UnknownGeometry":
        """Return the geometry with some unknowns known to be as documented."""
        known = object.__new__(UnknownGeometry)
        known.__dict__.update(self.__dict__)
        known.unknowns = [replace(unknown, sd=KEPT_SD_M) if at in known_ones else unknown
                          for at, unknown in enumerate(self.unknowns)]
        return known

    def posterior(self, seed: int) -> FloatArray:
        """Sample the posterior, shape (`N_PARTICLES`, n_unknowns)."""
        rng = rng_for(seed, "geometry", str(self.rows[0]["room_id"]))
        all_rirs, heights = np.arange(len(self.rows)), np.arange(N_SHARED, len(self.unknowns))
        geometry = np.arange(LATENCY + 1)
        blocks = [Block(geometry, all_rirs), Block(np.arange(LATENCY + 1, N_SHARED), all_rirs)]
        for height in heights:
            is_concerned = np.any([of_rirs == height for of_rirs in self._height_of.values()], axis=0)
            blocks.append(Block(np.array([height]), np.flatnonzero(is_concerned)))
        blocks.append(Block(np.concatenate([geometry, heights]), all_rirs))
        return anneal(self._draw(rng), self._log_prior, self._log_likelihood, blocks, self._symmetries(),
                      len(self.rows), rng)

    def _symmetries(self) -> list[Callable[[FloatArray], FloatArray]]:
        """Return the changes of geometry that leave all arrivals as they are, where no height is known."""
        if any(unknown.documented is not None for unknown in self.unknowns[N_SHARED:]):
            return []

        def mirror(values: FloatArray) -> FloatArray:
            mirrored = values.copy()
            mirrored[:, N_SHARED:] = values[:, 2:3] - values[:, N_SHARED:]
            mirrored[:, [_FLOOR, _CEILING]] = values[:, [_CEILING, _FLOOR]]
            return mirrored

        def exchange(values: FloatArray) -> FloatArray:
            exchanged = values.copy()
            exchanged[:, N_SHARED:] = values[:, :N_SHARED - 1:-1]
            return exchanged

        return [mirror, exchange] if len(self.unknowns) == N_SHARED + 2 else [mirror]

    def completed(self, n: int, estimates: Mapping[int, float]) -> RirRow:
        """Return the row of an RIR with the estimates of some unknowns in place of what is unknown or documented."""
        row: dict[str, Any] = dict(self.rows[n])
        row["room_dims_m"] = [round(estimates[axis], 4) if axis in estimates else size_m
                              for axis, size_m in enumerate(row["room_dims_m"])]
        for key, of_rirs in self._height_of.items():
            if of_rirs[n] in estimates:
                row[key] = [*row[key][:2], round(estimates[of_rirs[n]], 4)]
        return cast(RirRow, row)

    def _draw(self, rng: np.random.Generator) -> FloatArray:
        """Sample the prior."""
        mean, sd = self._prior()
        possible = np.empty((0, len(mean)))
        while len(possible) < N_PARTICLES:
            drawn = mean + sd * rng.standard_normal((N_PARTICLES, len(mean)))
            drawn[:, DIMS] = np.maximum(drawn[:, DIMS], self._least_dims_m)
            drawn[:, _HEARD] = rng.uniform(*HEARD, (N_PARTICLES, len(WALLS)))
            drawn[:, N_SHARED:] = np.clip(drawn[:, N_SHARED:], CLEARANCE_M, drawn[:, 2:3] - CLEARANCE_M)
            possible = np.concatenate([possible, drawn[np.isfinite(self._log_prior(drawn))]])
        return possible[:N_PARTICLES]

    def _prior(self) -> tuple[FloatArray, FloatArray]:
        return (np.array([unknown.mean for unknown in self.unknowns]),
                np.array([unknown.sd for unknown in self.unknowns]))

    def _log_prior(self, values: FloatArray) -> FloatArray:
        mean, sd = self._prior()
        deviation = (values - mean) / sd
        deviation[:, _HEARD] = 0.0  # uniform
        heard, dims_m, heights_m = values[:, _HEARD], values[:, DIMS], values[:, N_SHARED:]
        possible = np.all((heard >= HEARD[0]) & (heard <= HEARD[1]), axis=1)
        possible &= np.all(dims_m >= self._least_dims_m, axis=1)
        possible &= np.all((heights_m >= CLEARANCE_M) & (heights_m <= dims_m[:, 2:] - CLEARANCE_M), axis=1)
        return np.where(possible, -0.5 * np.sum(deviation ** 2, axis=1), -np.inf)

    def _log_likelihood(self, values: FloatArray, rirs: IntArray) -> FloatArray:
        sources_m, mics_m = (self._positions_m[key] for key in DEVICES)
        source_height, mic_height = (self._height_of[key] for key in DEVICES)
        return log_likelihoods(values, rirs, self._ratio, sources_m, mics_m, source_height, mic_height, self._of_speed,
                               early_images()[0], heard_probability(values[:, _HEARD]), self._direct_s)


@compiled
def log_likelihoods(values: FloatArray, rirs: IntArray, ratio: FloatArray, sources_m: FloatArray, mics_m: FloatArray,
                    source_height: IntArray, mic_height: IntArray, of_speed: FloatArray, cells: IntArray,
                    probability: FloatArray, direct_s: FloatArray) -> FloatArray:
    """Return the log-likelihood of the arrivals of some RIRs for each of some geometries.

    Parameters
    ----------
    values : ndarray, shape (n_points, n_unknowns)
    rirs : ndarray of int
    ratio : ndarray, shape (n, n_times)
        Of all RIRs, as all that follows; see `Arrivals`.
    sources_m, mics_m : ndarray, shape (n, 3)
        Of which the heights are unknowns with the numbers `source_height` and `mic_height`, shape (n,).
    of_speed : ndarray, shape (n,)
        Speed of sound of each RIR over the unknown one.
    cells, probability
        As for `roomeq.loop.arrivals.log_likelihood`.
    direct_s : ndarray, shape (n,)
        Time of the direct sound; NaN where sample 0 is not the emission.

    Returns
    -------
    ndarray, shape (n_points, n_rirs)
    """
    result = np.empty((len(values), len(rirs)))
    dims_m, source_m, mic_m = values[:, :3].copy(), np.empty((len(values), 3)), np.empty((len(values), 3))
    for column in range(len(rirs)):
        n = rirs[column]
        for point in range(len(values)):
            source_m[point, 0], source_m[point, 1] = sources_m[n, 0], sources_m[n, 1]
            mic_m[point, 0], mic_m[point, 1] = mics_m[n, 0], mics_m[n, 1]
            source_m[point, 2], mic_m[point, 2] = values[point, source_height[n]], values[point, mic_height[n]]
        speed_m_s = values[:, SPEED] * of_speed[n]
        result[:, column] = INDEPENDENT * log_likelihood(ratio[n], dims_m, speed_m_s, source_m, mic_m, cells,
                                                         probability)
        if not np.isnan(direct_s[n]):
            for point in range(len(values)):
                distance_m = np.sqrt(np.sum((source_m[point] - mic_m[point]) ** 2))
                late_ms = 1e3 * (direct_s[n] - distance_m / speed_m_s[point]) - values[point, LATENCY]
                result[point, column] += np.log(np.exp(-0.5 * (late_ms / DIRECT_SD_MS) ** 2) + DIRECT_OUTLIERS)
    return result


def _shared_unknowns(dims_m: Sequence[float], speed_m_s: float, timed: bool) -> list[Unknown]:
    """Return the unknowns that concern all RIRs of a room."""
    dims = [Unknown(f"{name} of the room", "m", size_m, sd_m, size_m)
            for name, size_m, sd_m in zip(("length", "width", "height"), dims_m, DIMENSION_SD_M, strict=True)]
    return [*dims, Unknown("speed of sound", "m/s", speed_m_s, SPEED_SD * speed_m_s, speed_m_s),
            Unknown("latency", "ms" if timed else "", 0.0, LATENCY_SD_MS, 0.0),
            *(Unknown(f"{wall} heard", "", 0.5, 0.3) for wall in WALLS)]


def declared_speed_m_s(row: Mapping[str, Any]) -> float:
    """Return the speed of sound at the temperature that a row declares, or at 20 degrees."""
    declared_c = row.get("temperature_c")
    return speed_of_sound_m_s(20.0 if declared_c is None else float(declared_c))


def assumed_position(lengths_m: Any, factor: float = 1.0) -> FloatArray:
    """Return lengths, such as a position, times a factor; an unknown height is the prior's mean."""
    return np.array([HEIGHT_M[0] if length_m is None else factor * length_m for length_m in lengths_m])
