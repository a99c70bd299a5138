"""Speech listed in a CSV: columns `file`, `transcript`, optional `utt_id`, `speaker`, `gender`, `set`."""

import os
import re
from pathlib import Path

from roomeq.corpora.record import DistinctIds
from roomeq.corpora.table import log_unused, read_table, resolve_file
from roomeq.corpora.utterance import Utterance
from roomeq.records.schema import make_id

_COLUMNS = ("file", "utt_id", "speaker", "gender", "set")
_TEXT_COLUMNS = ("transcript", "text", "sentence")
_GENDERS = {"m": "m", "male": "m", "f": "f", "female": "f"}


def list_transcripts(path: Path) -> dict[str, list[Utterance]]:
    """List the utterances of a CSV by set; without the column `set`, all belong to the set ``""``.

    Raises
    ------
    ValueError
        See `roomeq.corpora.table.read_table`; also a missing transcript, two speakers whose names have the same
        id, a file that is listed twice, two genders of a speaker, or a row without a set where others have one. The
        message names file and line.
    """
    columns, rows = read_table(path)
    text_column = next((name for name in _TEXT_COLUMNS if name in columns), None)
    if text_column is None:
        raise ValueError(f"{path}: columns {','.join(columns)} must hold 'transcript': add what is spoken")
    log_unused(path, columns, {*_COLUMNS, text_column})
    sets: dict[str, list[Utterance]] = {}
    ids = DistinctIds()
    of_file: dict[str, Utterance] = {}
    of_speaker: dict[str, Utterance] = {}
    for where, cells in rows:
        try:
            utterance = _utterance(path, cells, text_column, where, ids)
            if (first := of_file.setdefault(os.path.realpath(utterance.path), utterance)) is not utterance:
                raise ValueError(f"file={cells['file']!r} must be listed once and is also in {first.where}")
            if utterance.gender and (
                    first := of_speaker.setdefault(utterance.speaker, utterance)).gender != utterance.gender:
                raise ValueError(f"gender={cells['gender']!r} of speaker {utterance.speaker!r} contradicts "
                                 f"{first.gender!r} in {first.where}")
            sets.setdefault(cells.get("set", ""), []).append(utterance)
        except ValueError as error:
            raise ValueError(f"{where}: {error}: correct the row") from None
    if len(sets) > 1 and "" in sets:
        raise ValueError(f"{sets[''][0].where}: set='' must be a name, as in other rows: fill it in, or remove the row")
    return sets


def _utterance(path: Path, cells: dict[str, str], text_column: str, where: str,
               ids: DistinctIds) -> Utterance:
    file = resolve_file(path, cells)
    text = " ".join(cells.get(text_column, "").split())
    if not text:
        raise ValueError(f"{text_column}='' of {cells['file']} must hold the words that are spoken")
    voice = cells.get("speaker") or file.parent.name
    # Kaldi requires one order of speakers and of utterances: no character of a speaker may sort before '-'
    speaker = re.sub(r"[+-]", "_", make_id(voice))
    ids.add("speaker", speaker, voice)
    name = make_id(cells.get("utt_id") or file.stem)
    if not name.startswith(f"{speaker}-"):
        name = f"{speaker}-{name}"
    gender = cells.get("gender", "").lower()
    if gender not in ("", "?", *_GENDERS):
        raise ValueError(f"gender={gender!r} must be m or f")
    return Utterance(name, speaker=speaker, voice=speaker, gender=_GENDERS.get(gender), text=text, path=file,
                     where=where)
