"""Word error rates of parts of the test set: by room, by SNR and by the acoustics of the RIR."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.eq.distance import EqSet, wasserstein_db
from roomeq.eq.fit import eq_row, usable_eq
from roomeq.records.schema import RirRow
from roomeq.wer.scoring import read_texts
from roomeq.wer.workspace import BASE, TEST, Decodings, Scores

SNR, T20, DRR, C50, EQ_DISTANCE = "SNR [dB]", "T20 at 1 kHz [s]", "DRR [dB]", "C50 at 1 kHz [dB]", "EQ distance [dB]"
EDGES = {SNR: (10.0, 15.0, 20.0), T20: (0.3, 0.5, 0.8), DRR: (-5.0, 0.0, 5.0), C50: (0.0, 5.0, 10.0),
         EQ_DISTANCE: (4.0, 6.0, 8.0)}
"""Edges of the strata; the same for every test set."""
ACOUSTICS = (T20, DRR, C50, EQ_DISTANCE)
"""The properties that are of the RIR."""
MIN_ROOMS = 8
"""Rooms of which a rank correlation is stated."""
_DECIMALS = 9  # of what is ranked, so that rounding errors break no tie


class Breakdown:
    """The test set in parts.

    Parameters
    ----------
    decodings : Decodings
    scores : Scores
        Of the test set.
    rirs : dict
        Rows by RIR id.
    train_rirs : iterable of RirRow
        Measured RIRs that the recognisers were trained with. The EQ distance of an RIR is the distance of its EQ to
        all of theirs (`roomeq.eq.distance.wasserstein_db`); it is unknown if there are none. It is not 0 for an RIR
        like those of training, since these differ among themselves.

    Attributes
    ----------
    room_of : ndarray of int, shape (n_utterances,)
        Of the utterances of all seeds, one seed after the other: index into ``scores.room_names``.
    values : dict of ndarray, shape (n_utterances,)
        SNR and acoustics of each, by the keys of `EDGES`; NaN where unknown.
    """

    def __init__(self, decodings: Decodings, scores: Scores, rirs: dict[str, RirRow],
                 train_rirs: Iterable[RirRow] = ()) -> None:
        self.decodings, self.scores = decodings, scores
        self.room_of = np.concatenate(scores.rooms)
        used = [source for of_seed in scores.sources for source in of_seed]
        snr_db: list[float] = []
        for workspace, utterances in zip(decodings.workspaces, scores.utterances, strict=True):
            snr_of = _read_snr_db(workspace / "data" / TEST / "utt2snr")
            snr_db += [snr_of.get(utterance, np.nan) for utterance in utterances]
        train = _eq_set([row for row in train_rirs if not row.get("screen")])
        of_rir = {rir_id: _acoustics(rirs[rir_id], train) for rir_id in sorted(set(used))}
        self.values = {SNR: np.array(snr_db)} | {what: np.array([of_rir[rir_id][what] for rir_id in used])
                                                 for what in ACOUSTICS}

    def by_room(self) -> list[dict]:
        """Return the word error rates of each room over all seeds.

        Returns
        -------
        list of dict
            `room`, `words`, `wer` by column and row [%], and `acoustics`: the mean of each of `ACOUSTICS` over the
            room's utterances, None where it is unknown.
        """
        return [dict(room=name) | self._rates(self.room_of == n)
                | dict(acoustics={what: _mean(self.values[what][self.room_of == n]) for what in ACOUSTICS})
                for n, name in enumerate(self.scores.room_names)]

    def by_stratum(self) -> list[dict]:
        """Return the word error rates of each stratum over all seeds.

        Returns
        -------
        list of dict
            `what, low, high` (None where the stratum has no edge), `words`, and `wer` by column and row [%]. Strata
            without words are left out. An utterance of which a property is unknown is in none of its strata.
        """
        strata = []
        for what, edges in EDGES.items():
            values = self.values[what]
            stratum = np.digitize(values, edges)
            for n, (low, high) in enumerate(zip((None, *edges), (*edges, None), strict=True)):
                members = ~np.isnan(values) & (stratum == n)
                if members.any():
                    strata.append(dict(what=what, low=low, high=high) | self._rates(members))
        return strata

    def _rates(self, members: BoolArray) -> dict:
        """Return `words` and `wer` by column and row [%] of some utterances of all seeds."""
        words = int(np.concatenate(self.scores.words)[members].sum())
        rates: dict[str, dict[str, float]] = {column: {} for column in self.decodings.columns}
        for system in self.decodings.systems():
            errors = np.concatenate(self.scores.counts[system]).sum(axis=1)[members].sum()
            rates[system.column][system.row] = float(100 * errors / words)
        return dict(words=words, wer=rates)


def gains_by_acoustics(rooms: list[dict], rows: list[str], column: str) -> list[dict]:
    """Return how the change of a row against `BASE` in each room depends on the room's acoustics.

    Parameters
    ----------
    rooms : list of dict
        What `Breakdown.by_room` returns.
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
    found = {DRR: parameters.get("drr_db"), EQ_DISTANCE: wasserstein_db(own_eq, train) if own_eq and train else None}
    for what, values, valid in ((T20, parameters.get("t20_s"), parameters.get("t20_valid")),
                                (C50, parameters.get("c50_db"), parameters.get("c50_valid"))):
        found[what] = values[BAND_1KHZ] if values and valid and valid[BAND_1KHZ] else None
    return {what: np.nan if value is None else float(value) for what, value in found.items()}


def _eq_set(rows: Iterable[RirRow]) -> EqSet | None:
    """Return the EQs that rows state [dB], or None if none does."""
    stated = [row for row in rows if "eq_db" in (row.get("acoustic_parameters") or {})]
    vectors_db = [usable_eq(eq_row(Path(), row)) for row in stated]
    return EqSet(np.array(vectors_db), [row["room_id"] for row in stated]) if stated else None


def _mean(values: FloatArray) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else None


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
