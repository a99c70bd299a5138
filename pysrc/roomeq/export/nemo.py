"""Manifests of NeMo: JSON lines with `audio_filepath`, `duration`, `offset` and `text`.

https://docs.nvidia.com/nemo-framework/user-guide/latest/nemotoolkit/asr/datasets.html; paths are relative to the
manifest (`nemo.collections.common.parts.preprocessing.manifest`).
"""

from typing import Any

from roomeq.core.files import write_jsonl
from roomeq.export.content import Content

NO_TEXT = "-"
"""Transcript of RIRs and noises."""


def write_manifests(content: Content) -> None:
    """Write `manifest.json`, or `rirs.json` and others of RIRs and noises."""
    if content.utterances:
        write_jsonl(content.work / "manifest.json", [
            _line(utterance.audio.file, utterance.start_s, utterance.duration_s, utterance.text or "",
                  id=utterance.id, speaker=utterance.speaker, gender=utterance.gender,
                  lang=utterance.language, rir=utterance.rir, snr_db=utterance.snr_db, uniq=utterance.uniq)
            for utterance in content.utterances])
        return
    for folder, audio in content.by_folder().items():
        write_jsonl(content.work / f"{folder}.json", [
            _line(made.file, 0.0, made.duration_s, NO_TEXT, id=made.planned.id) for made in audio])


def _line(file: str, offset_s: float, duration_s: float, text: str, **more: Any) -> dict[str, Any]:
    return dict(audio_filepath=file, offset=offset_s, duration=duration_s, text=text,
                **{name: value for name, value in more.items() if value is not None})
