"""Word error rates of parts of the test set: by room, by SNR and by the acoustics of the RIR."""

from collections.abc import Collection, Iterable
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import spearmanr

from roomeq.core.arrays import FloatArray
from roomeq.eq.distance import EqSet, wasserstein_db
from roomeq.eq.fit import eq_row, usable_eq
from roomeq.records.parameters import value_of
from roomeq.records.schema import RirRow
from roomeq.wer.scores import Scores
from roomeq.wer.scoring import read_texts
from roomeq.wer.workspace import BASE, TEST, System, Workspace

SNR, T20, DRR, C50 = "SNR [dB]", "T20 at 1 kHz [s]", "DRR [dB]", "C50 at 1 kHz [dB]"
HIGH_EQ = "EQ at 4 and 8 kHz [dB]"
"""Mean of the two points: the level relative to 1 kHz."""
EQ_DISTANCE = "EQ distance [dB]"
EDGES = {SNR: (10.0, 15.0, 20.0), T20: (0.3, 0.5, 0.8), DRR: (-5.0, 0.0, 5.0), C50: (0.0, 5.0, 10.0),
         HIGH_EQ: (-6.0, -3.0, 0.0), EQ_DISTANCE: (4.0, 6.0, 8.0)}
"""Edges of the strata; the same for every test set."""
ACOUSTICS = (T20, DRR, C50, HIGH_EQ, EQ_DISTANCE)
"""The properties that are of the RIR."""
MIN_ROOMS = 8
"""Rooms of which a rank correlation is stated."""
_DECIMALS = 9  # of what is ranked, so that rounding errors break no tie


def ranges(what: str) -> list[tuple[float | None, float | None]]:
    """Return the lower and the upper end of each stratum of a property, None where it is open; [] if there is none."""
    edges = EDGES.get(what)
    return list(zip((None, *edges), (*edges, None), strict=True)) if edges else []


class StratumCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part of the test set: the range of a property, its words, and the errors in it by column and row."""

    what: str
    low: float | None
    high: float | None
    words: int
    errors: dict[str, dict[str, int]]


class Breakdown:
    """Counts of the test set in parts.

    Parameters
    ----------
    rirs : dict
        Rows by RIR id.
    train_rirs : iterable of RirRow
        Measured RIRs that the recognisers were trained with. The EQ distance of an RIR is the distance of its EQ to
        all of theirs (`roomeq.eq.distance.wasserstein_db`); it is unknown if there are none. It is not 0 for an RIR
        like those of training, since these differ among themselves.
    ambiguous : collection of str
        Ids that stand for several RIRs with different acoustics, as those of drawn rooms of different seeds.
    """

    def __init__(self, rirs: dict[str, RirRow], train_rirs: Iterable[RirRow] = (),
                 ambiguous: Collection[str] = ()) -> None:
        self._rirs, self._train = rirs, _eq_set([row for row in train_rirs if not row.get("screen")])
        self._ambiguous = set(ambiguous)
        self._of_rir: dict[str, dict[str, float]] = {}

    def room_of_rir(self, seed: int) -> dict[str, str]:
        """Return the room of each RIR by id. Drawn rooms of the same number are others with each seed."""
        return {rir_id: f"{row['room_id']} of seed {seed}" if row.get("measured_id", "") is None else row["room_id"]
                for rir_id, row in self._rirs.items()}

    def counts(self, workspace: Workspace, scores: Scores
               ) -> tuple[dict[str, dict[str, tuple[float, int]]], list[StratumCounts]]:
        """Return `acoustics` and `strata` of `roomeq.wer.counts.SeedCounts`.

        Strata without words are left out. An utterance of which a property is unknown is in none of its strata.

        Raises
        ------
        ValueError
            An RIR of the test set is ambiguous.
        """
        if ambiguous := sorted(self._ambiguous.intersection(scores.sources)):
            raise ValueError(f"{workspace.path}/data/{TEST}: its RIR {ambiguous[0]} has other acoustics in another "
                             f"directory of --rirs ({len(ambiguous)} such RIRs): give each RIR an id of its own")
        snr_of = _read_snr_db(workspace.path / "data" / TEST / "utt2snr")
        values = {what: np.array([self._acoustics(rir_id)[what] for rir_id in scores.sources]) for what in ACOUSTICS}
        acoustics = {name: {what: _sum_of_known(values[what][scores.room == n]) for what in ACOUSTICS}
                     for n, name in enumerate(scores.room_names)}
        values[SNR] = np.array([snr_of.get(utterance, np.nan) for utterance in scores.utterances])
        errors = {system: of_system.sum(axis=1) for system, of_system in scores.errors.items()}
        strata = []
        for what, edges in EDGES.items():
            stratum = np.digitize(values[what], edges)
            for n, (low, high) in enumerate(ranges(what)):
                members = ~np.isnan(values[what]) & (stratum == n)
                if members.any():
                    strata.append(StratumCounts(what, low, high, int(scores.words[members].sum()), {
                        column: {row: int(errors[System(row, column)][members].sum()) for row in workspace.rows}
                        for column in workspace.columns}))
        return acoustics, strata

    def _acoustics(self, rir_id: str) -> dict[str, float]:
        if rir_id not in self._of_rir:
            self._of_rir[rir_id] = _acoustics(self._rirs[rir_id], self._train)
        return self._of_rir[rir_id]


def gains_by_acoustics(rooms: list[dict], rows: list[str], column: str) -> list[dict]:
    """Return how the change of a row against `BASE` in each room depends on the room's acoustics.

    Parameters
    ----------
    rooms : list of dict
        What `roomeq.wer.measure` states of each room.
    rows : list of str
        Rows other than `BASE`.
    column : str
        Language model.

    Returns
    -------
    list of dict
        `row, what, rooms` (their number), `rho` (Spearman's rank correlation: negative if the row gains where the
        property is large) and `p`. Properties that fewer than `MIN_ROOMS` rooms have, or that are all equal, are left
        out.
    """
    found = []
    for row in rows:
        for what in ACOUSTICS:
            pairs = [(round(value, _DECIMALS), round(room["wer"][column][row] - room["wer"][column][BASE], _DECIMALS))
                     for room in rooms if (value := room["acoustics"][what]) is not None]
            if len(pairs) >= MIN_ROOMS and all(len(set(values)) > 1 for values in zip(*pairs, strict=True)):
                rho, p = spearmanr(*zip(*pairs, strict=True))
                found.append(dict(row=row, what=what, rooms=len(pairs), rho=float(rho), p=float(p)))
    return found


def _acoustics(row: RirRow, train: EqSet | None) -> dict[str, float]:
    """Return the acoustic parameters of an RIR by name; NaN where they are unknown or not valid."""
    parameters = row.get("acoustic_parameters") or {}
    own_eq = _eq_set([row])
    found = {DRR: parameters.get("drr_db"), EQ_DISTANCE: wasserstein_db(own_eq, train) if own_eq and train else None,
             HIGH_EQ: own_eq.vectors_db[0, -2:].mean() if own_eq else None,
             T20: value_of(parameters, "t20"), C50: value_of(parameters, "c50")}
    return {what: np.nan if value is None else float(value) for what, value in found.items()}


def _eq_set(rows: Iterable[RirRow]) -> EqSet | None:
    """Return the EQs that rows state [dB], or None if none does."""
    stated = [row for row in rows if "eq_db" in (row.get("acoustic_parameters") or {})]
    vectors_db = [usable_eq(eq_row(Path(), row)) for row in stated]
    return EqSet(np.array(vectors_db), [row["room_id"] for row in stated]) if stated else None


def _sum_of_known(values: FloatArray) -> tuple[float, int]:
    known = values[~np.isnan(values)]
    return float(known.sum()), len(known)


def _read_snr_db(path: Path) -> dict[str, float]:
    """Read ``utterance dB`` lines; return {} if the file is missing."""
    snr_of = {}
    for utterance, values in (read_texts(path) if path.is_file() else {}).items():
        try:
            (snr_of[utterance],) = map(float, values)
        except ValueError:
            raise ValueError(f"{path}: SNR {' '.join(values)!r} of {utterance!r} must be a number [dB]: make the data "
                             "directory again") from None
    return snr_of
