"""LibriSpeech as released: `SPEAKERS.TXT`, `<set>/<reader>/<chapter>/*.flac` and one `.trans.txt` per chapter.

As in the stock recipe, a Kaldi speaker is a reader and chapter (``1272-128104``).
"""

from collections.abc import Iterable
from pathlib import Path

from roomeq.core.files import read_text
from roomeq.corpora.utterance import Utterance

SPEAKERS_FILE = "SPEAKERS.TXT"


def find_sets(source: Path) -> dict[str, Path]:
    """Return the sets of a LibriSpeech tree by name; `source` may also be the folder above the tree, or one set."""
    for root in (source, source / "LibriSpeech"):
        sets = {path.name: path for path in sorted(root.glob("*")) if any(path.glob("*/*/*.trans.txt"))}
        if sets:
            return sets
    return {source.resolve().name: source} if any(source.glob("*/*/*.trans.txt")) else {}


def list_librispeech(sets: Iterable[Path]) -> list[Utterance]:
    """List the utterances of sets.

    Raises
    ------
    ValueError
        Transcripts and audio of a chapter do not match, or a name does not follow LibriSpeech.
    """
    utterances = []
    for path in sets:
        genders = read_genders(path.parent / SPEAKERS_FILE)
        for trans in sorted(path.glob("*/*/*.trans.txt")):
            utterances += _list_chapter(trans, genders)
    return utterances


def read_genders(path: Path) -> dict[str, str]:
    """Read `SPEAKERS.TXT` (``1272 | M | dev-clean | 8.00 | name``, the name may hold bars) as {reader: m or f}."""
    if not path.is_file():
        return {}
    genders = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if not line.startswith(";") and len(cells) > 1 and cells[1].lower() in ("m", "f"):
            genders[cells[0]] = cells[1].lower()
    return genders


def _list_chapter(trans: Path, genders: dict[str, str]) -> list[Utterance]:
    reader, chapter = trans.parent.parent.name, trans.parent.name
    audio = {path.stem: path for path in sorted(trans.parent.glob("*.flac"))}
    utterances, seen = [], set()
    for number, line in enumerate(read_text(trans).splitlines(), start=1):
        if not line.strip():
            continue
        name, _, text = line.strip().partition(" ")
        where = f"{trans}:{number}"
        if not name.startswith(f"{reader}-{chapter}-"):
            raise ValueError(f"{where}: utterance {name!r} must start with {reader}-{chapter}-: correct the line")
        if not text.strip():
            raise ValueError(f"{where}: utterance {name} has no words: correct or remove the line and its audio")
        if name in seen:
            raise ValueError(f"{where}: utterance {name} occurs twice: ids must be unique: remove one line")
        if name not in audio:
            raise ValueError(f"{where}: no audio {trans.parent / name}.flac: unpack the corpus again")
        seen.add(name)
        utterances.append(Utterance(name, speaker=f"{reader}-{chapter}", voice=reader, gender=genders.get(reader),
                                    text=text, path=audio.pop(name), where=where))
    if audio:
        first = next(iter(audio.values()))
        raise ValueError(f"{first}: no transcript in {trans} ({len(audio)} such): complete it or remove the audio")
    return utterances
