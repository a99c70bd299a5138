"""Speech as plain audio files in folders, without transcripts, as speech enhancement needs it."""

import re
from pathlib import Path

from roomeq.corpora.record import DistinctIds, audio_files
from roomeq.corpora.utterance import Utterance
from roomeq.records.schema import make_id


def list_audio_folder(source: Path) -> dict[str, list[Utterance]]:
    """List the audio files below a folder, each an utterance without text, by the folders that may be sets.

    Folders that all files share do not count. The first folder below them is the speaker, or a set if `source` holds
    the files in ``SET/SPEAKER/...``: the utterances are returned for either reading, under the name of each first
    folder and, all of them, under ``""``. The speaker of a file that lies in no folder is unknown: it is taken for one
    of its own, as Kaldi advises.

    Raises
    ------
    ValueError
        Two folders or files have the same id.
    """
    files = audio_files(source)
    below = [path.relative_to(source).parts for path in files]
    while below and len({parts[0] for parts in below}) == 1 and all(len(parts) > 1 for parts in below):
        below = [parts[1:] for parts in below]
    listed: dict[str, list[Utterance]] = {"": []}
    ids = DistinctIds()
    for path, parts in zip(files, below, strict=True):
        listed[""].append(_utterance(path, parts, ids, ""))
        if len(parts) > 1:
            listed.setdefault(parts[0], []).append(_utterance(path, parts[1:], ids, parts[0]))
    return listed


def _utterance(path: Path, parts: tuple[str, ...], ids: DistinctIds, name: str) -> Utterance:
    """Return the utterance of a file by its path below a set."""
    words = [*parts[:-1], Path(parts[-1]).stem]
    ident = make_id("-".join([*([name] if name else []), *words]))
    # Kaldi requires one order of speakers and of utterances: no character of a speaker may sort before '-'
    folder = re.sub("[+-]", "_", make_id(words[0]))
    speaker = make_id("-".join([*([name] if name else []), folder])) if len(words) > 1 else ident
    ids.add(f"utterance of set {name}", ident, str(path))
    if not ident.startswith(f"{speaker}-") and ident != speaker:  # of other characters, or a long name was hashed
        ident = make_id(f"{speaker}-{ident}")
    return Utterance(ident, speaker, voice=words[0] if len(words) > 1 else ident, gender=None, text=None, path=path,
                     where=str(path))
