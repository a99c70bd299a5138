"""Word error rates of parts of the test set: by room, by SNR, by decay time, by direct-to-reverberant ratio."""

from pathlib import Path

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.records.schema import RirRow
from roomeq.wer.scoring import read_reference, read_texts
from roomeq.wer.workspace import TEST, Decodings, Scores

EDGES = {"SNR [dB]": (10.0, 15.0, 20.0), "T20 at 1 kHz [s]": (0.3, 0.5, 0.8), "DRR [dB]": (-5.0, 0.0, 5.0)}
"""Edges of the strata; the same for every test set."""


def by_room(decodings: Decodings, scores: Scores) -> list[dict]:
    """Return the word error rates of each room over all seeds: `room`, `words`, and `wer` by column and row [%]."""
    rooms = np.concatenate(scores.rooms)
    return [dict(room=name) | _rates(decodings, scores, rooms == n) for n, name in enumerate(scores.room_names)]


def by_stratum(decodings: Decodings, scores: Scores, rirs: dict[str, RirRow]) -> list[dict]:
    """Return the word error rates of each stratum of the test set over all seeds.

    Parameters
    ----------
    scores
        Of the test set.
    rirs
        Rows by RIR id.

    Returns
    -------
    list of dict
        `what, low, high` (None where the stratum has no edge), `words`, and `wer` by column and row [%]. Strata
        without words are left out. An utterance of which a property is unknown is in none of its strata.
    """
    strata = []
    for what, values in _properties(decodings, rirs).items():
        stratum = np.digitize(values, EDGES[what])
        for n, (low, high) in enumerate(zip((None, *EDGES[what]), (*EDGES[what], None), strict=True)):
            members = ~np.isnan(values) & (stratum == n)
            if members.any():
                strata.append(dict(what=what, low=low, high=high) | _rates(decodings, scores, members))
    return strata


def _rates(decodings: Decodings, scores: Scores, members: BoolArray) -> dict:
    """Return `words` and `wer` by column and row [%] of some utterances of all seeds."""
    words = int(np.concatenate(scores.words)[members].sum())
    errors = {system: np.concatenate(counts).sum(axis=1)[members].sum() for system, counts in scores.counts.items()}
    rates: dict[str, dict[str, float]] = {column: {} for column in decodings.columns}
    for system in decodings.systems():
        rates[system.column][system.row] = float(100 * errors[system] / words)
    return dict(words=words, wer=rates)


def _properties(decodings: Decodings, rirs: dict[str, RirRow]) -> dict[str, FloatArray]:
    """Return each property of the test utterances, seed after seed; NaN where it is unknown."""
    values: dict[str, list[float]] = {what: [] for what in EDGES}
    for seed, workspace in enumerate(decodings.workspaces):
        data = workspace / "data" / TEST
        rir_of = read_texts(data / "utt2rir")
        snr_of = _read_snr_db(data / "utt2snr")
        for utterance in read_reference(decodings.decode_dir(seed, decodings.systems()[0], TEST)):
            parameters = rirs[rir_of[utterance][0]].get("acoustic_parameters") or {}
            valid = parameters.get("t20_valid", [False] * (BAND_1KHZ + 1))[BAND_1KHZ]
            t20_s = parameters["t20_s"][BAND_1KHZ] if valid else None
            for what, value in zip(EDGES, (snr_of.get(utterance), t20_s, parameters.get("drr_db")), strict=True):
                values[what].append(np.nan if value is None else value)
    return {what: np.array(of_utterances) for what, of_utterances in values.items()}


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
