"""Counts over the utterances of a far-field data directory, and the log lines that state them."""

import logging
import math
from collections import Counter
from pathlib import Path

from roomeq.augment.draw import Pool
from roomeq.augment.step import SUMMARY_FILE
from roomeq.core.constants import FS_HZ
from roomeq.core.files import read_json

logger = logging.getLogger(__name__)

_BIN_DB = 5


class Summary:
    """Counts over utterances, added one by one."""

    def __init__(self) -> None:
        self.n_utterances = self.n_samples = self.n_turned_down = 0
        self.rirs: Counter[str] = Counter()
        self.snrs: Counter[str] = Counter()
        self.noises: Counter[str] = Counter()

    def add(self, row: dict) -> None:
        """Count one row of `augment.jsonl`."""
        self.n_utterances += 1
        self.n_samples += row["n_samples"]
        self.n_turned_down += row["peak_gain_db"] < 0
        self.rirs[row["rir"]] += 1
        self.noises.update(noise["kind"] for noise in row["noises"])
        self.snrs["none" if row["snr_db"] is None else str(_BIN_DB * math.floor(row["snr_db"] / _BIN_DB))] += 1

    def as_dict(self, pool: Pool, n_recordings: int) -> dict:
        """Return what `summary.json` holds; the keys of `snr_histogram` are the lower edges of 5 dB bins."""
        return dict(utterances=self.n_utterances, recordings=n_recordings, hours=self.n_samples / FS_HZ / 3600,
                    rirs_used=len(self.rirs), rirs=len(pool.main),
                    rooms_used=len({pool.rows[rir_id]["room_id"] for rir_id in self.rirs}),
                    snr_histogram=dict(self.snrs), noises=dict(self.noises), turned_down=self.n_turned_down)


def log_summary(out: Path, elapsed_s: float | None) -> None:
    """Log the summary of a directory; `elapsed_s` is None if only a part of the work was done now."""
    summary = read_json(out / SUMMARY_FILE)
    histogram = summary["snr_histogram"]
    edges = sorted((edge for edge in histogram if edge != "none"), key=int)
    bins = [f"{edge}..{int(edge) + _BIN_DB}: {histogram[edge]}" for edge in edges]
    if "none" in histogram:
        bins.append(f"no noise: {histogram['none']}")
    rate = f", {summary['hours'] * 3600 / elapsed_s:.0f} times real time" if elapsed_s else ""
    logger.info("%s: %d utterances, %.2f h in %d recordings, %d of %d RIRs%s", out, summary["utterances"],
                summary["hours"], summary["recordings"], summary["rirs_used"], summary["rirs"], rate)
    logger.info("%s: utterances by SNR in dB: %s; the level of %d was reduced to avoid clipping", out,
                ", ".join(bins), summary["turned_down"])
