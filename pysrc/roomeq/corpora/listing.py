"""Recognise the kind of a measured corpus by its files, and list its recordings."""

from pathlib import Path

from roomeq.corpora.folder import list_folder, list_noise_folder
from roomeq.corpora.record import Corpus, Recording, audio_files
from roomeq.corpora.reverbdb import find_rooms, list_reverbdb
from roomeq.corpora.slr28 import find_measured_part, list_slr28
from roomeq.corpora.sofa_file import list_sofa
from roomeq.corpora.table import MANIFEST, list_noise_table, list_table
from roomeq.records.rir_dir import ROWS_FILE

READERS = {"reverbdb": list_reverbdb, "slr28": list_slr28, "table": list_table, "sofa": list_sofa,
           "folder": list_folder}
"""Readers by kind of corpus."""


def detect_kind(source: Path) -> str:
    """Return the kind of a corpus, a key of `READERS`.

    Raises
    ------
    ValueError
        The folder is an RIR directory already, or holds speech.
    """
    if source.is_file():
        by_suffix = {".csv": "table", ".tsv": "table", ".sofa": "sofa"}
        return by_suffix.get(source.suffix.lower(), "folder")
    if (source / ROWS_FILE).is_file():
        raise ValueError(f"{source}: is an RIR directory already ({ROWS_FILE}): use it as it is")
    if (source / "wav.scp").is_file():
        raise ValueError(f"{source}: is a Kaldi data directory with speech (wav.scp), but RIRs are expected here: "
                         "pass it as the speech corpus")
    if find_rooms(source):
        return "reverbdb"
    if find_measured_part(source):
        return "slr28"
    if find_manifest(source):
        return "table"
    return "sofa" if not audio_files(source) and any(source.rglob("*.sofa")) else "folder"


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
        source = manifest
    return READERS[kind](source)


def list_noises(source: Path) -> list[Recording]:
    """List noise recordings; see `roomeq.corpora.measured.read_noises`."""
    table = source if source.suffix.lower() in (".csv", ".tsv") else find_manifest(source)
    return list_noise_table(table) if table else list_noise_folder(source)


def find_manifest(source: Path) -> Path | None:
    """Return the `manifest.csv` of a folder, or None."""
    path = source / MANIFEST
    return path if source.is_dir() and path.is_file() else None


def require_existing(path: Path) -> Path:
    """Return the path of a corpus; raise a `ValueError` where there is nothing."""
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path}: no such file or directory: check the path of the corpus")
    return path
