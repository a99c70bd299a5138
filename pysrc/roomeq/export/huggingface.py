"""Folders of audio files with `metadata.jsonl`, which `datasets` loads as ``audiofolder``.

https://huggingface.co/docs/datasets/audio_dataset. `README.md` names each folder as a configuration with one split:
otherwise `datasets` takes words such as "test" in the names of files for splits, and leaves out the metadata.
"""

import logging
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from roomeq.core.files import write_jsonl, write_text
from roomeq.export.audio import MadeAudio
from roomeq.export.content import Content, ExportedUtterance
from roomeq.records.parameters import value_of

logger = logging.getLogger(__name__)

_TIME = re.compile(r"\d{4}-\d\d-\d\d([ T]\d\d(:\d\d){0,2}(Z|[+-]\d\d(:?\d\d)?)?)?")  # in JSON, for pyarrow
_OF_ROW = ("room_id", "source_id", "mic_id", "noise_for", "room_dims_m", "source_pos_m", "mic_pos_m", "channel_pos_m",
           "distance_m", "target_t60_s")
"""Keys of `rirs.jsonl` that become columns."""
_METRICS = {"t20_s": "t20", "t30_s": "t30", "edt_s": "edt", "c50_db": "c50"}
"""Keys of acoustic parameters that become columns, and the metric of each."""


def write_manifests(content: Content) -> None:
    """Write `metadata.jsonl` into each folder, and `README.md`."""
    by_folder = content.by_folder()
    utterance_of = {utterance.audio.file: utterance for utterance in content.utterances}
    for folder, audio in by_folder.items():
        rows = [dict(file_name=os.path.relpath(made.file, folder), id=made.planned.id,
                     **(_of_utterance(utterance_of[made.file]) if utterance_of
                        else _of_rir(made) if made.planned.is_rir else _of_noise(made))) for made in audio]
        _warn_of_times(content, folder, rows)
        write_jsonl(content.work / folder / "metadata.jsonl", rows)
    configurations = "".join(f"- config_name: {folder}\n  data_files:\n  - split: train\n    path: {folder}/**\n"
                             for folder in by_folder)
    write_text(content.work / "README.md", f"---\nconfigs:\n{configurations}---\n")


def _warn_of_times(content: Content, folder: str, rows: Sequence[dict[str, Any]]) -> None:
    """Log the columns that `datasets` takes for times: it knows types from values only."""
    for name in rows[0]:
        known = [row[name] for row in rows if row[name] is not None]
        if known and all(isinstance(value, str) and _TIME.fullmatch(value) for value in known):
            logger.warning("%s: datasets will read %s of %s as times, since all look like %r: rename one, or give "
                           "load_dataset the features", content.out, name, folder, known[0])


def _of_utterance(utterance: ExportedUtterance) -> dict[str, Any]:
    return dict(text=utterance.text, speaker_id=utterance.speaker, gender=utterance.gender,
                language=utterance.language, duration=utterance.duration_s, rir=utterance.rir,
                snr_db=utterance.snr_db, uniq=utterance.uniq)


def _of_rir(made: MadeAudio) -> dict[str, Any]:
    row = made.planned.row or {}
    parameters = row.get("acoustic_parameters") or {}
    return dict(direct_sample=made.direct_sample, **{key: row.get(key) for key in _OF_ROW},
                **{key: _valid_values(parameters, key) for key in _METRICS}, drr_db=parameters.get("drr_db"))


def _valid_values(parameters: Mapping[str, Any], key: str) -> list[float | None] | None:
    """Return a value per octave band, None where it is not valid; None if nothing was measured."""
    values = parameters.get(key)
    return values and [value_of(parameters, _METRICS[key], band) for band in range(len(values))]


def _of_noise(made: MadeAudio) -> dict[str, Any]:
    return dict(room_id=(made.planned.row or {}).get("room_id"), duration=made.duration_s)
