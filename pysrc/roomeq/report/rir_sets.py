"""Values of RIR directories that several sections use."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ
from roomeq.eq.fit import eq_row, usable_eq
from roomeq.eq.gmm import with_reference
from roomeq.records.parameters import reverberation_time_s
from roomeq.records.schema import AcousticParameters, RirRow
from roomeq.report.kinds import Kind
from roomeq.report.load import Missing, Run

LIKE_T60 = 0.1
"""Largest relative difference of the T60 of RIRs that are compared one with one: two just noticeable differences."""


@dataclass(frozen=True)
class SimulatedDecay:
    """The decay of a simulated RIR at 1 kHz.

    Parameters
    ----------
    ident : str
        Id of the RIR.
    target_s, t30_s : float
        Target T60 and T30 of the rendered RIR [s].
    leaked_share : float, optional
        Share of the rays that left the room through a gap in its mesh.
    """

    ident: str
    target_s: float
    t30_s: float
    leaked_share: float | None

    @property
    def error(self) -> float:
        """Relative error of the T30."""
        return abs(self.t30_s / self.target_s - 1)


def unscreened(run: Run, name: str) -> list[RirRow]:
    """Return the RIRs of a directory that take part in EQ fits and distances."""
    return [row for row in run.rirs(name) if not row.get("screen")]


def eq_vectors(run: Run, name: str) -> FloatArray:
    """Return the EQ of a directory's unscreened RIRs.

    Returns
    -------
    ndarray, shape (n_rirs, 8)
        EQ gains relative to 1 kHz [dB]; NaN where invalid.

    Raises
    ------
    Missing
        The screening excludes all RIRs.
    """
    def compute() -> FloatArray:
        vectors = [with_reference(usable_eq(eq_row(run.path(name), row))) for row in unscreened(run, name)]
        if not vectors:
            raise Missing(f"an RIR in data/{name} that passes the screening", "a larger measured corpus")
        return np.array(vectors)

    return run.cached(("eq", name), compute)


def direct_sample(run: Run, name: str, row: RirRow) -> float:
    """Return the position of the direct sound in an RIR [samples]."""
    stored = (row.get("acoustic_parameters") or row).get("direct_sample")
    return find_direct(run.rir(name, row), FS_HZ)[0] if stored is None else stored


def simulated_decays(run: Run) -> list[SimulatedDecay]:
    """Return the decay times of the simulated training and development RIRs that state target and T30."""
    decays = []
    for name in ("rirs.sim.train", "rirs.sim.dev"):
        for row in run.rirs(name) if run.has(name) else []:
            target_s, t30_s = row.get("target_t60_s"), row.get("t30_s")
            if target_s and t30_s:
                decays.append(SimulatedDecay(row["id"], target_s, t30_s, row.get("leaked_share")))
    return decays


def eq_errors(run: Run, names: Iterable[str]) -> FloatArray:
    """Return the absolute differences between achieved and target EQ.

    Returns
    -------
    ndarray, shape (n_rirs, 8)
        Errors [dB]; no rows if no directory states them.
    """
    errors = [row["eq_error_db"] for name in names if run.has(name) for row in run.rirs(name) if row.get("eq_error_db")]
    return np.abs(np.array(errors, dtype=np.float64).reshape(-1, len(BANDS_HZ)))


def acoustic_parameters(rows: Iterable[RirRow]) -> list[AcousticParameters]:
    """Return the acoustic parameters of the RIRs that have them."""
    return [parameters for row in rows if (parameters := row.get("acoustic_parameters"))]


def reverberation_times(parameters: Iterable[AcousticParameters]) -> FloatArray:
    """Return T30 at 1 kHz, or T20 where T30 is invalid [s]; RIRs without either are left out."""
    return np.array([time_s for time_s in map(reverberation_time_s, parameters) if time_s is not None])


def measured_example(run: Run, kinds: Iterable[Kind]) -> dict[Kind, RirRow]:
    """Choose one RIR of each kind to show: a measured one and its simulated counterparts in every other kind.

    Since the T60 of simulated RIRs is random, only pairs are compared whose T60 at 1 kHz differs by at most two just
    noticeable differences; of these, the measured RIR is the one nearest to the median EQ. If there is no such pair, it
    is the pair with the nearest T60, or the RIR nearest to the median EQ where no T60 is known.

    Returns
    -------
    dict
        A row of the training RIRs of each kind that the run has. Where no measured RIR has a counterpart in all kinds,
        as in drawn rooms, these are not of one place: see `are_paired`.
    """
    measured, *others = kinds
    rows = unscreened(run, measured.train)
    eq_db = eq_vectors(run, measured.train)
    distance = np.nansum((eq_db - column_percentiles(eq_db, (50,))[0]) ** 2, axis=1)
    nearest = [rows[n] for n in np.argsort(distance, kind="stable")]
    simulated = {kind: run.rirs(kind.train) for kind in others if run.has(kind.train)}
    by_measured_id = {kind: {row.get("measured_id"): row for row in members} for kind, members in simulated.items()}
    paired = [row for row in nearest if all(row["id"] in index for index in by_measured_id.values())]
    mismatch = {row["id"]: max((t60_mismatch(row, index[row["id"]]) for index in by_measured_id.values()), default=0.0)
                for row in paired}
    close = [row for row in paired if mismatch[row["id"]] <= LIKE_T60]
    chosen = (close or sorted(paired, key=lambda row: mismatch[row["id"]]) or nearest)[0]
    return {measured: chosen} | {kind: by_measured_id[kind].get(chosen["id"], members[0])
                                 for kind, members in simulated.items()}


def are_paired(chosen: dict[Kind, RirRow]) -> bool:
    """Tell whether the simulated RIRs of `measured_example` have the room and positions of the measured one."""
    measured, *others = chosen.values()
    return all(row.get("measured_id") == measured["id"] for row in others)


def t60_at_1khz(row: RirRow) -> float | None:
    """Return the T30 at 1 kHz of an RIR, or its T20 where T30 is invalid [s]; None if neither is known."""
    if row.get("t30_s"):
        return row["t30_s"]
    times = reverberation_times(acoustic_parameters([row]))
    return float(times[0]) if len(times) else None


def t60_mismatch(measured: RirRow, simulated: RirRow) -> float:
    """Return the relative difference of the T60 at 1 kHz of two RIRs; infinite where one is unknown."""
    times = t60_at_1khz(measured), t60_at_1khz(simulated)
    return abs(times[1] / times[0] - 1.0) if times[0] and times[1] else np.inf


def decay_shapes(rows: Iterable[RirRow]) -> FloatArray:
    """Return the T30 of each octave relative to that at 1 kHz, of the RIRs that have one there; NaN where invalid.

    Returns
    -------
    ndarray, shape (n_rirs, 8)
    """
    shapes = [np.where(np.array(p["t30_valid"], dtype=bool), np.array(p["t30_s"], dtype=np.float64), np.nan)
              for p in acoustic_parameters(rows)]
    times_s = np.array(shapes, dtype=np.float64).reshape(-1, len(BANDS_HZ))
    known = times_s[np.isfinite(times_s[:, BAND_1KHZ])]
    return known / known[:, [BAND_1KHZ]]


def column_percentiles(values: FloatArray, percents: Iterable[float]) -> list[FloatArray]:
    """Return percentiles of each column without its NaNs; NaN for a column of NaNs."""
    columns = [column[np.isfinite(column)] for column in values.T]
    return [np.array([np.percentile(column, p) if len(column) else np.nan for column in columns]) for p in percents]


def without_rare(values: FloatArray) -> FloatArray:
    """Return values with NaN in the columns of which less than half are known: those that are would be no fair sample.

    At low frequencies, for example, a decay time is valid if it is long.
    """
    return np.where(2 * np.isfinite(values).sum(axis=0) >= len(values), values, np.nan)


def describe_eq(name: str, eq_db: FloatArray) -> str:
    """Return an EQ as text for readers who cannot see the figure."""
    return f"{name}: " + ", ".join(f"{db:.0f} dB at {hz:g} Hz" for hz, db in zip(BANDS_HZ, eq_db, strict=True))
