"""A folder of audio files without metadata: the folders in it are the rooms, everything else is unknown."""

from collections.abc import Iterable
from pathlib import Path

from roomeq.corpora.record import (
    Corpus,
    DistinctIds,
    Recording,
    audio_files,
    excitation_of,
    folder_name,
    id_of_path,
    is_binaural_name,
    noise_kind_of,
    rir_row,
)


def list_folder(source: Path) -> Corpus:
    """List the RIRs of a folder (or of one audio file).

    Raises
    ------
    ValueError
        There is no audio in it, it holds transcripts, or the names of two rooms have the same id.
    """
    files, root = _audio_of(source)
    if transcripts := min(root.rglob("*.trans.txt"), default=None):
        raise ValueError(f"{source}: holds speech ({transcripts.relative_to(root)}), but RIRs are expected here: "
                         "pass it as the speech corpus")
    name = folder_name(root)
    corpus = Corpus(name=name, kind="folder")
    ids = DistinctIds()
    for path in files:
        below = path.parent.relative_to(root).parts
        room = below[0] if below else name
        if len(below) > 1:
            corpus.notes[f"RIR in a folder of a folder of {name}, which is taken for the room"] += 1
        row = rir_row(corpus=name, room_id=room, excitation=excitation_of(path.stem),
                      binaural=is_binaural_name(str(path.relative_to(root))))
        try:
            ids.add("room", row["room_id"], room)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        corpus.rirs.append(Recording(path, id_of_path(path, root), row))
    return corpus


def list_noise_folder(source: Path) -> list[Recording]:
    """List the noises of a folder: the name tells the kind (room tone and silence are ambient), the room is unknown.

    Raises
    ------
    ValueError
        There is no audio in it.
    """
    files, root = _audio_of(source)
    return noises_of(files, root)


def noises_of(files: Iterable[Path], root: Path, kind: str | None = None) -> list[Recording]:
    """Return noises of unknown rooms with ids made from their paths below `root`; their names tell the kind if None."""
    return [Recording(path, id_of_path(path, root),
                      dict(room_id=None, kind=kind or noise_kind_of(str(path.relative_to(root)))))
            for path in files]


def _audio_of(source: Path) -> tuple[list[Path], Path]:
    files = [source] if source.is_file() else audio_files(source)
    if not files:
        raise ValueError(f"{source}: no audio files below it: check the path")
    return files, (source.parent if source.is_file() else source)
