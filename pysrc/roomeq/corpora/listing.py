"""Recognise the kind of a measured corpus by its files, and list its recordings."""

import logging
from collections.abc import Iterable
from pathlib import Path

from roomeq.core.digests import files_below
from roomeq.core.files import physical
from roomeq.corpora.folder import list_folder, list_noise_folder
from roomeq.corpora.record import Corpus, Recording, audio_files, folder_name, id_of_path, is_sofa
from roomeq.corpora.reverbdb import find_rooms, list_reverbdb
from roomeq.corpora.slr28 import find_measured_part, list_slr28
from roomeq.corpora.table import MANIFEST, find_manifest, list_noise_table, list_table, refuse_spreadsheet
from roomeq.records.rir_dir import ROWS_FILE

logger = logging.getLogger(__name__)


def list_sofa(source: Path) -> Corpus:
    """List one SOFA file, or all below a folder; their content is read later, file by file.

    Raises
    ------
    ValueError
        There is no SOFA file, or a name of one is that of a folder, a FIFO or a device.
    """
    files = [source] if source.is_file() else _sofa_files(source)
    if not files:
        raise ValueError(f"{source}: no .sofa files below it: check the path")
    if other := next((path for path in files if path.suffix != ".sofa"), None):
        raise ValueError(f"{other}: a SOFA file's name must end in .sofa: rename it, or choose another kind")
    for path in files:
        if not path.is_file():
            raise ValueError(f"{path}: a SOFA file must be a regular file: remove it")
    root, name = (source.parent, source.stem) if source.is_file() else (source, folder_name(source))
    return Corpus(name=name, kind="sofa", rirs=[
        Recording(path, id_of_path(path, root), dict(corpus=name)) for path in files])


def _sofa_files(source: Path) -> list[Path]:
    paths = [path for path in source.rglob("*") if is_sofa(path)]  # also what is no file, which is refused by name
    return sorted({*paths, *filter(is_sofa, files_below(source))})


READERS = {"reverbdb": list_reverbdb, "slr28": list_slr28, "table": list_table, "sofa": list_sofa,
           "folder": list_folder}
"""Readers by kind of corpus."""


def detect_kind(source: Path) -> str:
    """Return the kind of a corpus, a key of `READERS`.

    Raises
    ------
    ValueError
        The folder is an RIR directory already, or holds speech, a spreadsheet as its manifest, or both SOFA and audio
        files.
    """
    refuse_spreadsheet(source)
    if source.is_file():
        by_suffix = {".csv": "table", ".tsv": "table", ".sofa": "sofa"}
        return by_suffix.get(source.suffix.lower(), "folder")
    if (source / ROWS_FILE).is_file():
        raise ValueError(f"{source}: is an RIR directory already ({ROWS_FILE}): give the recordings that it was "
                         "made from, or run the single steps on it, from roomeq characterise on")
    if (source / "wav.scp").is_file():
        raise ValueError(f"{source}: is a Kaldi data directory with speech (wav.scp), but RIRs are expected here: "
                         "pass it as the speech corpus")
    if find_rooms(source):
        return "reverbdb"
    if find_measured_part(source):
        return "slr28"
    if find_manifest(source):
        return "table"
    sofa = _sofa_files(source)
    if sofa and (audio := audio_files(source, warn=False)):
        raise ValueError(f"{source}: holds SOFA files ({sofa[0].relative_to(source)}) and audio files "
                         f"({audio[0].relative_to(source)}): name the kind to read, sofa or folder, or list both in "
                         f"{MANIFEST}")
    return "sofa" if sofa else "folder"


def list_corpus(source: Path, kind: str | None = None) -> Corpus:
    """List a corpus by the reader of its kind.

    Raises
    ------
    ValueError
        The kind is unknown, or the corpus has no recordings of that kind.
    """
    if kind is not None and kind not in READERS:
        raise ValueError(f"kind={kind!r} must be one of {', '.join(READERS)}")
    kind = kind or detect_kind(source)
    if kind == "table" and source.is_dir():
        manifest = find_manifest(source)
        if not manifest:
            raise ValueError(f"{source}: no {MANIFEST} in it: name the CSV file itself")
        corpus = list_table(manifest)
        _count_unlisted(manifest, corpus.rirs)
        return corpus
    return READERS[kind](source)


def list_noises(source: Path) -> list[Recording]:
    """List noise recordings; see `roomeq.corpora.measured.read_noises`."""
    refuse_spreadsheet(source)
    table = source if source.suffix.lower() in (".csv", ".tsv") else find_manifest(source)
    if table is None:
        return list_noise_folder(source)
    noises = list_noise_table(table)
    if source.is_dir():
        _count_unlisted(table, noises)
    return noises


def _count_unlisted(manifest: Path, listed: Iterable[Recording]) -> None:
    """Log how many audio files below the folder of a manifest it does not list."""
    known = {physical(recording.path) for recording in listed}
    unlisted = [path for path in audio_files(manifest.parent, warn=False) if physical(path) not in known]
    if unlisted:
        logger.info("%s: %d audio files below its folder are not in it, and are not read (the first: %s)", manifest,
                    len(unlisted), unlisted[0].relative_to(manifest.parent))


def require_existing(path: Path) -> Path:
    """Return the path of a corpus; raise a `ValueError` where there is nothing."""
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path}: no such file or directory: check the path of the corpus")
    return path
