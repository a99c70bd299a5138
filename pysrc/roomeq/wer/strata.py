"""Word error rates of parts of the test set: by signal-to-noise ratio, decay time and direct-to-reverberant ratio."""

from pathlib import Path

import numpy as np

from roomeq.core.constants import BAND_1KHZ
from roomeq.records.schema import RirRow
from roomeq.wer.scoring import read_reference, read_texts
from roomeq.wer.workspace import TEST, Decoded, Scores

EDGES = {"SNR [dB]": (10.0, 15.0, 20.0), "T20 at 1 kHz [s]": (0.3, 0.5, 0.8), "DRR [dB]": (-5.0, 0.0, 5.0)}
"""Where parts end: the same for every test set, whatever it shows."""


def by_stratum(decoded: Decoded, scores: Scores, rirs: dict[str, RirRow]) -> list[dict]:
    """Return the test set's word error rates by stratum, over all seeds.

    Parameters
    ----------
    scores : Scores
        Of the test set.
    rirs : dict of dict
        Row by RIR id.

    Returns
    -------
    list of dict
        `what, low, high` (an edge, or None where there is none), `words` and, where there are any, `wer` by column and
        row [%]. Utterances of which a property is not known are in none of its strata.
    """
    words = np.concatenate(scores.words)
    errors = {system: np.concatenate(counts).sum(axis=1) for system, counts in scores.counts.items()}
    found = []
    for what, values in _properties(decoded, rirs).items():
        known = ~np.isnan(values)
        place = np.digitize(values, EDGES[what])
        for n, (low, high) in enumerate(zip((None, *EDGES[what]), (*EDGES[what], None), strict=True)):
            here = known & (place == n)
            if here.any():
                found.append(dict(what=what, low=low, high=high, words=int(words[here].sum()), wer={
                    column: {row: float(100 * errors[row, column][here].sum() / words[here].sum())
                             for row in decoded.rows} for column in decoded.columns}))
    return found


def _properties(decoded: Decoded, rirs: dict[str, RirRow]) -> dict[str, np.ndarray]:
    """Return each property of all utterances, of seed after seed; NaN where it is not known."""
    found = {what: [] for what in EDGES}
    for seed, workspace in enumerate(decoded.workspaces):
        data = workspace / "data" / TEST
        rir_of = read_texts(data / "utt2rir")
        snr_of = _snr_db(data / "utt2snr")
        for utterance in read_reference(decoded.decode(seed, decoded.rows[0], TEST, decoded.columns[0])):
            parameters = rirs[rir_of[utterance][0]].get("acoustic_parameters") or {}
            valid = parameters.get("t20_valid", [False] * (BAND_1KHZ + 1))[BAND_1KHZ]
            t20_s = parameters["t20_s"][BAND_1KHZ] if valid else None
            for what, value in zip(EDGES, (snr_of.get(utterance), t20_s, parameters.get("drr_db")), strict=True):
                found[what].append(np.nan if value is None else value)
    return {what: np.array(values) for what, values in found.items()}


def _snr_db(path: Path) -> dict[str, float]:
    """Read ``utterance dB`` lines; none where nobody wrote them."""
    found = {}
    for utterance, values in (read_texts(path) if path.is_file() else {}).items():
        try:
            (value,) = map(float, values)
        except ValueError:
            raise ValueError(f"{path}: SNR {' '.join(values)!r} of {utterance!r} must be a number [dB]: make the data "
                             "directory again") from None
        found[utterance] = value
    return found
