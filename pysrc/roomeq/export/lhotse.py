"""Manifests of lhotse: https://lhotse.readthedocs.io/en/latest/corpus.html."""

import gzip
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from roomeq.core.files import to_json, write_bytes
from roomeq.export.align import MAX_LATE_S
from roomeq.export.audio import MadeAudio
from roomeq.export.content import Content, ExportedUtterance
from roomeq.export.plan import RIRS

logger = logging.getLogger(__name__)

LATE_RIRS = "late_rirs"
"""Manifest of RIRs with which lhotse would advance speech by more than `MAX_LATE_S`."""


def write_manifests(content: Content) -> None:
    """Write `recordings.jsonl.gz` and `supervisions.jsonl.gz`, or `rirs.jsonl.gz` and others of RIRs and noises."""
    for folder, audio in content.by_folder().items():
        if folder == RIRS:
            late = [made for made in audio if (made.late_s or 0.0) > MAX_LATE_S]
            audio = [made for made in audio if (made.late_s or 0.0) <= MAX_LATE_S]
            if late:
                _write(content.work / f"{LATE_RIRS}.jsonl.gz", map(_recording, late))
                logger.info("%s: %d of %d RIRs are in %s.jsonl.gz: their strongest reflection comes more than %g ms "
                            "after the direct sound, and lhotse aligns speech to it", content.out, len(late),
                            len(late) + len(audio), LATE_RIRS, 1000 * MAX_LATE_S)
        if audio:
            _write(content.work / f"{folder}.jsonl.gz", map(_recording, audio))
    if content.utterances:
        _write(content.work / "supervisions.jsonl.gz", map(_supervision, content.utterances))


def _recording(made: MadeAudio) -> dict[str, Any]:
    channels = list(range(made.n_channels))
    return dict(id=made.planned.id, sources=[dict(type="file", channels=channels, source=made.file)],
                sampling_rate=made.rate_hz, num_samples=made.n_samples, duration=made.duration_s, channel_ids=channels)


def _supervision(utterance: ExportedUtterance) -> dict[str, Any]:
    custom = dict(rir=utterance.rir, snr_db=utterance.snr_db, uniq=utterance.uniq)
    return _known(id=utterance.id, recording_id=utterance.audio.planned.id, start=utterance.start_s,
                  duration=utterance.duration_s, channel=0, text=utterance.text, speaker=utterance.speaker,
                  gender=utterance.gender, language=utterance.language, custom=_known(**custom) or None)


def _known(**fields: Any) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}


def _write(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    text = "".join(to_json(row) + "\n" for row in rows)
    write_bytes(path, gzip.compress(text.encode(), mtime=0))  # without the time: equal content, equal bytes
