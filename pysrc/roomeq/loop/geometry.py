"""Geometry that nobody measured, or only roughly, estimated from the arrivals of early reflections.

An unknown height becomes the mean of its posterior (`roomeq.loop.unknown_geometry`): the prior's mean where the
recordings do not tell. Where they fit two geometries, such as a room and its mirror image, it becomes the mean of the
heavier mode, since the mean of both would have other arrivals; the stated spread includes the other mode. A documented
height or dimension is replaced only if the evidence against it is decisive.
Nothing is estimated of rooms that are meshes.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.core.groups import numbers_by
from roomeq.core.workers import share_out
from roomeq.loop.arrivals import Arrivals, measure_arrivals
from roomeq.loop.unknown_geometry import DIMS, HEIGHT_OF, N_SHARED, Unknown, UnknownGeometry, declared_speed_m_s
from roomeq.loop.usable import Located
from roomeq.records.geometry import distance_between, is_too_close
from roomeq.records.rir_dir import load_rir, rir_path
from roomeq.records.schema import RirRow, is_timed
from roomeq.sim.scene import MIN_WALL_DISTANCE_M

logger = logging.getLogger(__name__)

TOLERANCE_M = 0.02
"""A length is as documented if it is this close."""
DECISIVE = 1.3
"""Least evidence against a documented value that is replaced: a Bayes factor of 20."""
HARDLY_TOLD = 0.7
"""Spread of a posterior, relative to the prior's, from which on the recordings hardly tell."""
BIMODAL = 3.0
"""Two parts of a posterior are modes if their means are this many of their standard deviations apart."""


@dataclass(frozen=True)
class Estimate:
    """An estimated quantity of a room's geometry.

    Attributes
    ----------
    room : str
    quantity : str
        Such as "height of the room".
    unit : str
    prior, posterior : tuple of float
        Mean and standard deviation. Of a posterior with two modes: the mean of the heavier, and the deviation of all
        samples from it.
    documented : float or None
    evidence : float
        log10 of the Bayes factor against the documented value, or the prior's mean where there is none. The number of
        particles limits it to about 2.
    used : bool
        Whether the simulation has the posterior's mean, not the documented value.
    """

    room: str
    quantity: str
    unit: str
    prior: tuple[float, float]
    posterior: tuple[float, float]
    documented: float | None
    evidence: float
    used: bool

    @property
    def is_told(self) -> bool:
        """Whether the recordings tell the quantity."""
        return self.posterior[1] < HARDLY_TOLD * self.prior[1]

    def __str__(self) -> str:
        told = "" if self.is_told else " (the recordings hardly tell)"
        documented = "" if self.documented is None else f", documented {self.documented:.2f}"
        return f"{self.quantity} {self.posterior[0]:.2f} +- {self.posterior[1]:.2f} {self.unit}{documented}{told}"

    def as_dict(self) -> dict[str, Any]:
        """Return the ledger's entry."""
        return asdict(self) | dict(prior=list(self.prior), posterior=list(self.posterior))


class Completed(NamedTuple):
    """Rows whose geometry was completed, in the order of the given ones, and what was estimated."""

    rows: list[RirRow]
    estimates: list[Estimate]


def unknown_heights_m(estimates: Sequence[Estimate]) -> dict[str, dict[str, float]]:
    """Return the heights that no row states and the recordings tell, by room and device (`Model.heights_m`)."""
    heights_m: dict[str, dict[str, float]] = {}
    for estimate in estimates:
        if estimate.unit == "m" and estimate.documented is None and estimate.is_told:
            device = estimate.quantity.removeprefix(HEIGHT_OF)
            heights_m.setdefault(estimate.room, {})[device] = round(estimate.posterior[0], 4)
    return heights_m


def complete_geometry(rirs: Sequence[Located], seed: int, nj: int) -> tuple[list[Located], list[Estimate]]:
    """Estimate the unknown geometry of usable RIRs, and log what was estimated.

    Parameters
    ----------
    rirs : sequence of Located
        See `roomeq.loop.usable`.
    seed, nj : int

    Returns
    -------
    list of Located
        In the order of `rirs`; all coordinates are known.
    list of Estimate
        By room.

    Raises
    ------
    ValueError
        An RIR cannot be read or has no direct sound; the message names the file.
    """
    completed, rooms = list(rirs), numbers_by(None if row.get("mesh") else row["room_id"] for _, row in rirs)

    def of_room(members: list[int]) -> Completed:
        return complete_room([rirs[n].row for n in members], [_arrivals(rirs[n]) for n in members], seed)

    estimates: list[Estimate] = []
    for members, room in zip(rooms.values(), share_out(of_room, rooms.values(), nj, first_here=False,
                                                              label="estimate geometry of rooms"), strict=True):
        for n, row in zip(members, room.rows, strict=True):
            completed[n] = Located(rirs[n].directory, row)
        if used := [estimate for estimate in room.estimates if estimate.used]:
            logger.info("%s: estimated %s", used[0].room, "; ".join(map(str, used)))
        estimates += room.estimates
    return completed, estimates


def _arrivals(rir: Located) -> Arrivals:
    row = rir.row
    distance_m = distance_between(row["source_pos_m"], row["mic_pos_m"]) if is_timed(row) else None
    expected = None if distance_m is None else distance_m / declared_speed_m_s(row) * FS_HZ
    samples = load_rir(rir.directory, row)
    try:
        return measure_arrivals(samples, expected)
    except ValueError as error:
        raise ValueError(f"{rir_path(rir.directory, row)}: {error}") from None


def complete_room(rows: Sequence[RirRow], arrivals: Sequence[Arrivals], seed: int) -> Completed:
    """Estimate the unknown geometry of a room.

    Parameters
    ----------
    rows : sequence of RirRow
        Rows of one shoebox with the same dimensions; all horizontal coordinates are known.
    arrivals : sequence of Arrivals
        What their RIRs say.
    seed : int

    Returns
    -------
    Completed
        Rows with all coordinates. Horizontal coordinates are kept; documented heights and dimensions are, unless
        the evidence against them is decisive.
    """
    geometry = UnknownGeometry(rows, arrivals)
    free = _estimates(geometry, seed)
    estimates = free
    kept = {at for at, estimate in enumerate(free) if estimate.unit == "m" and not estimate.used
            and estimate.evidence < 0.0}
    if kept and any(estimate.used for estimate in free):
        # what is more likely as documented than not helps to find the rest
        rest = _estimates(geometry.with_known(kept), seed)
        estimates = [rest[at] if estimate.used else estimate for at, estimate in enumerate(free)]
    estimates = _possible(geometry, estimates)
    return Completed(_completed(geometry, estimates), [estimate for estimate in estimates if estimate.unit])


def _used(estimates: Sequence[Estimate]) -> dict[int, float]:
    return {at: estimate.posterior[0] for at, estimate in enumerate(estimates) if estimate.used}


def _possible(geometry: UnknownGeometry, estimates: list[Estimate]) -> list[Estimate]:
    """Keep what is documented of a room if the simulator cannot take the estimates.

    Heights, if they would bring a source and a microphone too close. Dimensions, if a position that is kept lies
    outside of them, such as a microphone at the ceiling, above a suspended one that nobody wrote down.
    """
    if any(is_too_close(math.dist(row["source_pos_m"], row["mic_pos_m"])) for row in _completed(geometry, estimates)):
        estimates = _as_documented(estimates, range(N_SHARED, len(estimates)))
    fits = all(MIN_WALL_DISTANCE_M <= at_m <= size_m - MIN_WALL_DISTANCE_M for row in _completed(geometry, estimates)
               for position_m in (row["source_pos_m"], row["mic_pos_m"])
               for at_m, size_m in zip(position_m, row["room_dims_m"], strict=True))
    return estimates if fits else _as_documented(estimates, range(*DIMS.indices(len(estimates))))


def _completed(geometry: UnknownGeometry, estimates: Sequence[Estimate]) -> list[Any]:
    return [geometry.completed(n, _used(estimates)) for n in range(len(geometry.rows))]


def _as_documented(estimates: Sequence[Estimate], which: range) -> list[Estimate]:
    return [replace(estimate, used=False) if at in which and estimate.documented is not None else estimate
            for at, estimate in enumerate(estimates)]


def _estimates(geometry: UnknownGeometry, seed: int) -> list[Estimate]:
    """Return the estimates of all unknowns."""
    posterior = geometry.posterior(seed)
    is_main = _main_mode(posterior[:, N_SHARED:])
    return [_estimate(geometry, at, posterior, is_main) for at in range(len(geometry.unknowns))]


def _main_mode(heights_m: FloatArray) -> BoolArray:
    """Tell which samples are of the heavier mode of a posterior of heights, all of them if it has one mode.

    The samples are divided by 2-means along their principal axis.
    """
    along_m = (heights_m - heights_m.mean(axis=0)) @ np.linalg.svd(
        heights_m - heights_m.mean(axis=0), full_matrices=False)[2][0]
    upper = along_m > 0.0
    for _ in range(20):
        upper = along_m > 0.5 * (along_m[upper].mean() + along_m[~upper].mean())
    apart_m = along_m[upper].mean() - along_m[~upper].mean()
    if apart_m < BIMODAL * np.hypot(along_m[upper].std(), along_m[~upper].std()):
        return np.ones(len(heights_m), dtype=bool)
    return upper if 2 * upper.sum() >= len(upper) else ~upper


def _estimate(geometry: UnknownGeometry, at: int, posterior: FloatArray, is_main: BoolArray) -> Estimate:
    unknown, samples, mean = geometry.unknowns[at], posterior[:, at], float(posterior[is_main, at].mean())
    evidence = _evidence_against(unknown, samples)
    used = unknown.unit == "m" and (unknown.documented is None or evidence >= DECISIVE)
    return Estimate(str(geometry.rows[0]["room_id"]), unknown.quantity, unknown.unit, (unknown.mean, unknown.sd),
                    (mean, float(np.sqrt(np.mean((samples - mean) ** 2)))), unknown.documented, evidence, used)


def _evidence_against(unknown: Unknown, samples: FloatArray) -> float:
    """Return log10 of the density of the prior at the documented value over that of the posterior (Savage and Dickey).

    Both densities are means over the tolerance. Half a particle is added at the documented value: none of them being
    there limits the density and does not make it zero.
    """
    tolerance = TOLERANCE_M if unknown.unit == "m" else 0.2 * unknown.sd
    reference = unknown.mean if unknown.documented is None else unknown.documented
    deviation = np.append((samples - reference) / tolerance, 0.0)
    weight = np.append(np.ones(len(samples)), 0.5)
    log_posterior = logsumexp(-0.5 * deviation ** 2, b=weight) - np.log(weight.sum() * tolerance)
    wide = np.hypot(unknown.sd, tolerance)
    log_prior = -0.5 * ((unknown.mean - reference) / wide) ** 2 - np.log(wide)
    return float((log_prior - log_posterior) / np.log(10.0))
