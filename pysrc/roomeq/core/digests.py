"""Hashes of everything that an output depends on: files, directories, audio that they refer to, and the code."""

import contextlib
import hashlib
import json
import logging
import os
import re
import shlex
import sys
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from roomeq.core.files import hash_file, physical, read_text
from roomeq.core.kept_hashes import hashes_of_input, quick_look
from roomeq.core.stamps import Stamp, read_stamp, require_as_stamped, require_audio_as_stamped, require_in_place

logger = logging.getLogger(__name__)

READ_IF_PRESENT = ("noises.jsonl", "rirs.jsonl", "segments", "spk2gender", "text", "utt2dur", "utt2lang", "utt2rir",
                   "utt2snr", "utt2uniq")
"""Tables that readers use where they are, also if somebody has put them beside the files of a step."""
LIST_FOR_KALDI = "rir_list"
"""Table of RIRs for Kaldi, which names audio by the path of the directory."""
_TABLES_OF_ROWS = ("rirs.jsonl", "noises.jsonl")
"""Tables whose rows name audio."""
_NUMERICS = ("espeakng-loader", "llvmlite", "numba", "numpy", "scikit-learn", "scipy", "soundfile", "soxr", "trimesh")
"""Packages whose version decides results: numerical libraries, the compiler of the kernels, and eSpeak NG."""
_OFFSET = re.compile(r":\d+$")
_SHELL_SYNTAX = re.compile(r"[\s|&;<>()`'\"]+")
_LIST = re.compile(r"[,\s]+")  # between the names of several files in an option
_SPECIFIER = re.compile(r"(?:ark|scp)(?:,\w+)*:")  # before the name in an rspecifier of Kaldi
# in a command: it may read files whose names are not among its words
_INDIRECT = re.compile(r"[$`*?]|\bcd\b|(?<![\w./-])scp(?:,\w+)*:")


class Listed(NamedTuple):
    """Files that a reader lists, which may stand among many that do not matter.

    Attributes
    ----------
    files : tuple of Path
        A file that is absent is hashed as absent: reading it raises the error.
    root : Path, optional
        Names count from this directory on, so that the hash is the same wherever it lies.
    """

    files: tuple[Path, ...]
    root: Path | None = None


class Content(NamedTuple):
    """What an input holds.

    Attributes
    ----------
    digest : str
        Hash of it.
    files : dict
        Hash and time of modification [ns] of each file that counts, by path; None: there is no such file.
    """

    digest: str
    files: dict[str, tuple[str | None, int | None]]


def digest(given: Path | Listed) -> str:
    """Return the hash of an input; see `content_of`."""
    return content_of(given).digest


def content_of(given: Path | Listed, *, warn: bool = True) -> Content:
    """Return what a file, a directory or listed files hold, and the audio that a directory's tables name.

    A directory that a `Build` made is hashed by the content hashes in its stamp, once its files are found to be as the
    stamp says, and by `READ_IF_PRESENT` and audio named there; where it refers to audio elsewhere, by the stamp's key
    and the content of that audio too. Any other directory is hashed by the content of all its files, and of the audio
    that its tables name.

    Parameters
    ----------
    given
    warn
        Warn where commands may read files that they do not name.

    Raises
    ------
    ValueError
        There is no such path, the directory has the formats of another version, or something in it has been lost or
        has changed since a step made it.
    """
    if isinstance(given, Listed):
        return _content_of_listed(given)
    path = Path(given)
    if path.is_file():
        of_file = hash_file(path)
        _require_as_stamped_above([(str(path), of_file)])
        return Content(of_file, _with_times({str(path): of_file}))
    if not path.is_dir():
        raise ValueError(f"{path}: no such file or directory: check the path, or run the step that makes it")
    stamp = read_stamp(path)
    total = hashlib.sha256(stamp.key.encode() if stamp and stamp.refers else b"")
    content: dict[str, str | None]
    if stamp:
        require_in_place(path, stamp)
        require_as_stamped(path, stamp)
        content = {name: content_hash for name, (_, content_hash) in stamp.files.items()}
        content |= {name: hash_file(path / name) for name in READ_IF_PRESENT
                    if name not in content and (path / name).is_file()}
        content |= _audio_of_added_rows(path, stamp)
    else:
        files = files_below(path)
        content = dict(zip((str(file.relative_to(path)) for file in files),
                           hashes_of_input(os.path.realpath(path), files), strict=True))
    content.pop(LIST_FOR_KALDI, None)  # no step reads it, and it depends on the place of the directory
    for name, content_hash in content.items():
        total.update(f"{name}\0{content_hash}\n".encode(errors="surrogateescape"))
    hashes = {str(path / name): content_hash for name, content_hash in content.items()}
    if not stamp or stamp.refers:
        audio = audio_elsewhere(path, warn=warn)
        if stamp:
            require_audio_as_stamped(path, stamp, audio)
        else:
            _require_as_stamped_above((str(file), content_hash) for file, content_hash in audio.values())
        for name, (_, content_hash) in audio.items():
            total.update(f"{name}\0{content_hash}\n".encode(errors="surrogateescape"))
        hashes |= {str(file): content_hash for file, content_hash in audio.values()}
    return Content(total.hexdigest(), _with_times(hashes))


def _content_of_listed(listed: Listed) -> Content:
    names = [str(path) for path in listed.files]
    list_hash = hashlib.sha256("\n".join(names).encode(errors="surrogateescape")).hexdigest()
    hashes = dict(zip(names, hashes_of_input(list_hash, listed.files), strict=True))
    _require_as_stamped_above(hashes.items())
    total = hashlib.sha256()
    for name in names:
        known_as = os.path.relpath(name, listed.root) if listed.root is not None else name
        total.update(f"{known_as} {hashes[name]}\n".encode(errors="surrogateescape"))
    return Content(total.hexdigest(), _with_times(hashes))


def _with_times(hashes: Mapping[str, str | None]) -> dict[str, tuple[str | None, int | None]]:
    timed: dict[str, tuple[str | None, int | None]] = {}
    for name, content_hash in hashes.items():
        look = quick_look(Path(name))
        timed[name] = content_hash, look.mtime_ns if look else None
    return timed


def require_unchanged(given: Path | Listed, before: Content) -> None:
    """Refuse an input of which a file has been written to since it was read, also one that has the same content again.

    Files that have come since, such as a log or another output in the folder, were not read.

    Raises
    ------
    ValueError
        A file has changed or has gone; the message names it.
    """
    now = content_of(given, warn=False)
    changed = [name for name, was in before.files.items() if now.files.get(name) != was]
    if changed:
        raise ValueError(f"{changed[0]}: was written to meanwhile")


def _audio_of_added_rows(directory: Path, stamp: Stamp) -> dict[str, str | None]:
    """Return hashes, by name, of audio that a directory's stamp does not list and tables beside its files name.

    Raises
    ------
    ValueError
        A file has been lost or has changed since another step made it.
    """
    found = _audio_in_rows(directory, (table for table in _TABLES_OF_ROWS if table not in stamp.files))
    found = {wav: path for wav, path in found.items() if wav not in stamp.files}
    hashes = dict(zip(found, _hashes_of_audio(found.values()), strict=True))
    _require_as_stamped_above((str(path), hashes[wav]) for wav, path in found.items())
    return hashes


def _require_as_stamped_above(hashes: Iterable[tuple[str, str | None]]) -> None:
    """Refuse files that a step made and that are not as the stamp in a folder above them says.

    Parameters
    ----------
    hashes : iterable of tuple
        Path of each file and its content hash; None: there is no such file.

    Raises
    ------
    ValueError
        A file is missing or has changed since it was made.
    """
    known: dict[str, tuple[Path, Stamp] | None] = {}
    for path, content_hash in hashes:
        path = os.path.abspath(path)
        if found := _stamp_above(os.path.dirname(path), known):
            directory, stamp = found
            stated = stamp.files.get(os.path.relpath(path, directory))
            if stated and stated[1] != content_hash:
                require_as_stamped(directory, replace(stamp, files={os.path.relpath(path, directory): stated}))


def _stamp_above(folder: str, known: dict[str, tuple[Path, Stamp] | None]) -> tuple[Path, Stamp] | None:
    """Return the nearest directory with a stamp, from a folder upwards, and the stamp."""
    if folder not in known:
        stamp, parent = None, os.path.dirname(folder)
        with contextlib.suppress(ValueError, OSError):  # not a stamp of ours, or of another version
            stamp = read_stamp(Path(folder))
        if stamp:
            known[folder] = Path(folder), stamp
        else:
            known[folder] = _stamp_above(parent, known) if parent != folder else None
    return known[folder]


def audio_elsewhere(directory: Path, out: Path | None = None, *,
                    warn: bool = True) -> dict[str, tuple[Path, str | None]]:
    """Return path and content hash of the audio files that a directory's tables name and that lie elsewhere, by name.

    Hidden files, which `files_below` leaves out, count as elsewhere.

    The reader of a table reports lines that are wrong. A file that is absent has the hash None.

    Parameters
    ----------
    directory : Path
    out : Path, optional
        Where the directory will lie.
    warn : bool
        Warn where commands may read files that they do not name.
    """
    found = _audio_in_rows(directory, _TABLES_OF_ROWS)
    with contextlib.suppress(OSError, ValueError):
        entries = _entries(directory)
        if warn:
            _warn_of_indirect(directory, entries)
        names = {name for entry in entries for name in names_in_entry(entry)}
        found |= {name: Path(name) for name in sorted(names) if quick_look(Path(name))}
    own, resolve = {os.path.realpath(folder) for folder in (directory, out or directory)}, cache(os.path.realpath)
    found = {name: path for name, path in found.items() if not _is_among_files_below(physical(path, resolve), own)}
    hashes = _hashes_of_audio(found.values())
    return {name: (path, content_hash) for (name, path), content_hash in zip(found.items(), hashes, strict=True)}


def _warn_of_indirect(directory: Path, entries: list[str]) -> None:
    """Log a warning where commands may read files that they do not name."""
    indirect = [entry for entry in entries if entry.endswith("|") and _INDIRECT.search(entry)]
    if indirect:
        logger.warning("%s: %d commands may read files that they name with cd, $, `, a pattern or a list (scp:): "
                       "changes of these go unnoticed, and outputs stay as they are: name the files (the first: %s)",
                       directory / "wav.scp", len(indirect), indirect[0])


def _audio_in_rows(directory: Path, tables: Iterable[str]) -> dict[str, Path]:
    """Return paths of the audio that rows of some of a directory's tables name, by that name."""
    found, resolve = {}, cache(os.path.realpath)
    for table in tables:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            # a row may hold characters at which str.splitlines would break it
            for line in filter(None, read_text(directory / table).split("\n")):
                wav = json.loads(line)["wav"]
                found[wav] = physical(directory / wav, resolve)
    return found


def _hashes_of_audio(paths: Collection[Path]) -> list[str | None]:
    listed = hashlib.sha256("\n".join(map(str, paths)).encode(errors="surrogateescape")).hexdigest()
    return hashes_of_input(listed, paths)


def place_in_entries(directory: Path, out: Path) -> str:
    """Return the path of `out`, one of `places_of`, by which the `wav.scp` of a directory names files below it.

    Kaldi's `rir_list` names audio from the folder from which `out` is given. Empty: no table names files that way.
    """
    if (directory / LIST_FOR_KALDI).is_file():
        return str(out)
    with contextlib.suppress(OSError, ValueError):
        names = {name for entry in _entries(directory) for name in names_in_entry(entry)}
        return next((place for place in places_of(out) if any(name.startswith(f"{place}/") for name in names)), "")
    return ""


def places_of(out: Path) -> tuple[str, str]:
    """Return the paths by which the `wav.scp` of a directory may name files in it: as given, and the physical one."""
    return str(out), str(physical(out))


def _entries(directory: Path) -> list[str]:
    return [line.split(maxsplit=1)[-1] for line in filter(None, read_text(directory / "wav.scp").split("\n"))]


def names_in_entry(entry: str) -> set[str]:
    """Return names that may be those of files that an entry of `wav.scp` reads.

    They are the whole entry and its words, each also without a colon and a number at its end: they are the offset in an
    archive, or part of the name. The entry is split at blanks, and again at quotes, brackets and the shell's operators
    too, since a name may hold brackets. What follows the first ``=`` of a word is a word as well; so are the parts of a
    list with commas, and what follows ``ark:`` or ``scp:``.
    """
    words = [entry.strip(), *(word.rstrip("|") for word in entry.split()), *_SHELL_SYNTAX.split(entry)]
    if {"'", '"', "\\"} & set(entry):
        words += _unquoted(entry)
    if "=" in entry:
        words += [word.partition("=")[2] for word in words]
    words += [part for word in words if "," in word for part in _LIST.split(word)]
    words += [_SPECIFIER.sub("", word, count=1) for word in words if _SPECIFIER.match(word)]
    return {name for word in words if word for name in (word, _OFFSET.sub("", word))}


def _unquoted(command: str) -> list[str]:
    """Return the words of a command without their quotes, and those of commands in it, as of ``bash -c '...'``.

    A command with a quote that does not end has none.
    """
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.whitespace_split, lexer.commenters = True, ""
    try:
        words = list(lexer)
    except ValueError:
        return []
    inner = [word for word in words if word != command and set(word) & set(" \t'\"\\")]
    return words + [name for word in inner for name in _unquoted(word)]


def files_below(directory: Path, left_out: str | None = None) -> list[Path]:
    """Return all files below a directory except hidden ones, in a fixed order; a linked folder is entered once.

    Folders of the name `left_out` are not entered.
    """
    files, entered = [], set()
    for folder, folders, names in os.walk(directory, followlinks=True):
        real = os.path.realpath(folder)
        if real in entered:  # a link to a folder above would never end
            folders.clear()
            continue
        entered.add(real)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name != left_out)
        paths = (Path(folder) / name for name in sorted(names) if not name.startswith("."))
        files += [path for path in paths if path.is_file()]
    return files


def _is_among_files_below(path: Path, directories: Iterable[str]) -> bool:
    """Tell whether `files_below` returns a file of directories, all given by physical paths; it may be absent."""
    inside = str(path)
    return any(inside.startswith(f"{directory}/") and "/." not in inside[len(directory):] for directory in directories)


@cache
def code_digest() -> str:
    """Return `code_digest_now` as it was when this process first asked.

    It must ask before it loads the code that works, which stays as it was loaded.
    """
    return code_digest_now()


def code_digest_now() -> str:
    """Return a hash of the package's source and of the versions of Python and of the packages in `_NUMERICS`."""
    total = hashlib.sha256(f"Python {sys.version_info[:2]}".encode())
    total.update(" ".join(_installed_numerics()).encode())
    total.update(source_digest(Path(__file__).parents[1]).encode())
    return total.hexdigest()


def _installed_numerics() -> list[str]:
    """Return names and versions of those of `_NUMERICS` that are installed: the names of their ``.dist-info`` folders.

    They are what `importlib.metadata.version` looks for. Its import takes longer than all the rest that tells whether
    an output is up to date.
    """
    wanted = {name.replace("-", "_") for name in _NUMERICS}
    found: dict[str, str] = {}
    for folder in sys.path:
        with contextlib.suppress(OSError):
            for name in sorted(os.listdir(folder or ".")):
                package, _, version = name.lower().partition("-")
                if version.endswith(".dist-info") and package in wanted:
                    found.setdefault(package, name)  # the first on the path is imported
    return sorted(found.values())


def source_digest(*paths: Path) -> str:
    """Return a hash of source files, given one by one or as folders with all that belongs to their package."""
    total = hashlib.sha256()
    for path in paths:
        for file in files_below(path, "__pycache__") if path.is_dir() else [path]:
            total.update(f"{file.relative_to(path)}\0".encode() + file.read_bytes())
    return total.hexdigest()
