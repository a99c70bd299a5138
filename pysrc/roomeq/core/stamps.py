"""The stamp of a directory that a step made: which step, from what, and which files with which content.

The stamp (`.done`) is the last file that `roomeq.core.build.Build` writes: a directory with a stamp is complete. It
carries the version of the formats in the directory: a reader refuses a directory of another version, and the step that
made the directory makes it anew.

A directory is used as it was made. A step refuses an input with a file that is lost or not as the stamp says, or that
refers to audio which is not as it was: whoever changes a file on purpose removes the stamp, and the content counts.
"""

import hashlib
import os
import stat
import time
from pathlib import Path
from typing import Any

import msgspec

from roomeq.core.files import hash_file, read_json, to_json

DONE_FILE = ".done"

FORMAT = 2
"""Version of the files that this roomeq reads and writes. 1 had no `format` in its stamp."""

_COMMANDS = {"split": "roomeq split-rirs", "enough-rooms": "local/enough_rooms.py", "dict": "local/make_dict.py",
             "digits": "local/prepare_digits.py",
             "synthetic-rirs": "local/make_synthetic_rirs.py", "synthetic-speech": "local/make_synthetic_speech.py",
             "standin-rirs": "local/make_synthetic_rirs.py", "standin-speech": "local/make_synthetic_speech.py"}
"""Commands of steps that are not called ``roomeq STEP``; the last two steps had these names in format 1."""


class Stamp(msgspec.Struct, frozen=True):
    """What a stamp says.

    Attributes
    ----------
    step : str
        Step that made the directory, e.g. ``"simulate"``.
    key : str
        Hash of the step, its options, inputs and code.
    files : dict
        Size and hash of every file by name.
    format : int
        Version of the formats of these files.
    options : dict
        Options of the step.
    refers : bool
        The directory names audio elsewhere.
    audio : dict
        Hash of each audio file elsewhere, by the name that it has in the directory's tables.
    place : str
        Path of the directory where its `wav.scp` or `rir_list` names audio by it, as Kaldi requires, else empty: the
        physical one, or as it was given, which may be relative to the folder where the step ran. The step makes the
        directory anew in another place.
    made_of : dict
        Hash (`roomeq.core.digests.digest`) of each input that a step had made, by its path from the directory.
    """

    step: str
    key: str
    files: dict[str, tuple[int, str]]
    format: int = 1
    options: dict[str, Any] = {}
    refers: bool = False
    audio: dict[str, str] = {}
    place: str = ""
    made_of: dict[str, str] = {}

    @property
    def command(self) -> str:
        """The command that makes such a directory."""
        return _COMMANDS.get(self.step, f"roomeq {self.step}")


def stamp_content(**fields: Any) -> dict[str, Any]:
    """Return what a stamp file holds: the fields of `Stamp`, and a hash of them that tells a damaged stamp."""
    return dict(fields, check=_check(fields))


def _check(fields: dict[str, Any]) -> str:
    return hashlib.sha256(to_json(fields).encode(errors="surrogateescape")).hexdigest()


def was_made(path: Path) -> bool:
    """Tell whether a step made a directory, or the directory that holds a file: it has a stamp."""
    return any((directory / DONE_FILE).is_file() for directory in (path, path.parent))


def read_stamp(directory: Path) -> Stamp | None:
    """Return the stamp of a directory, or None where it has none; for readers of the directory.

    Raises
    ------
    ValueError
        The file is not a stamp, or the directory has the formats of another version of roomeq.
    """
    stamp = _read_any_format(directory)
    if stamp and stamp.format != FORMAT:
        age = "an older" if stamp.format < FORMAT else "a newer"
        raise ValueError(f"{directory}: was written by {age} roomeq (format {stamp.format}, not {FORMAT}): run "
                         f"{stamp.command} again")
    return stamp


def _read_any_format(directory: Path) -> Stamp | None:
    path = Path(directory) / DONE_FILE
    if not path.is_file():
        return None
    damaged = f"{path}: is damaged: remove {directory} and make it again"
    try:
        content = read_json(path)
    except ValueError:
        raise ValueError(damaged) from None
    if (isinstance(content, dict) and content.get("format") == FORMAT
            and content.pop("check", None) not in (None, _check(content))):
        raise ValueError(damaged)
    try:
        return msgspec.convert(content, Stamp)
    except (msgspec.ValidationError, UnicodeEncodeError):
        raise ValueError(f"{path}: is not a stamp of roomeq (step, key, files): remove {directory} and make it "
                         "again") from None


def when_stamped_ns(directory: Path) -> int:
    """Return when the stamp of a directory was written [ns].

    The time of its inode is later where the directory was copied, moved to another disk, or given other permissions: a
    file that had changed before may then seem older than the stamp, whose time of modification as a rule stays.
    """
    status = (directory / DONE_FILE).stat()
    return min(status.st_ctime_ns, status.st_mtime_ns)


def is_as_stamped(directory: Path, name: str, size: int, content_hash: str, stamped_ns: int) -> bool:
    """Tell whether a file is as its directory's stamp says; it is only read if it has changed since then.

    Parameters
    ----------
    directory : Path
    name, size, content_hash
        The file's entry in the stamp.
    stamped_ns : int
        When the stamp was written: see `when_stamped_ns`.
    """
    path = directory / name
    status = path.stat()
    return (status.st_size == size and stat.S_ISREG(status.st_mode)
            and (_is_older(directory, name, stamped_ns) or hash_file(path) == content_hash))


def _is_older(directory: Path, name: str, stamped_ns: int) -> bool:
    """Tell whether a file, and each folder between it and its directory, was there before the stamp.

    It is the inode's time that tells: what is moved to here keeps its time of modification. Of a link, both its own and
    that of what it leads to must tell: a link that was set later may lead to an older file, and a file behind an older
    link may have changed since. Within a tick of the clock, times tell nothing; nor does a stamp of the future, as the
    clock has been set back since: what was written later may seem older.
    """
    if stamped_ns > time.time_ns():
        return False
    return all(look(directory / part).st_ctime_ns < stamped_ns for part in (Path(name), *Path(name).parents)
               if part.name for look in (os.lstat, os.stat))


def require_as_stamped(directory: Path, stamp: Stamp, *, quick: bool = True) -> None:
    """Refuse a directory with a file that is not as its stamp says; files beside them may come and go.

    Parameters
    ----------
    directory : Path
    stamp : Stamp
        Its stamp.
    quick : bool
        Read only files that have changed in some way since the stamp was written. False: read all.

    Raises
    ------
    ValueError
        A file is missing or has changed.
    """
    stamped_ns = when_stamped_ns(directory) if quick else 0
    for name, (size, content_hash) in stamp.files.items():
        try:
            unchanged = is_as_stamped(directory, name, size, content_hash, stamped_ns)
        except (FileNotFoundError, NotADirectoryError):
            raise ValueError(f"{directory / name}: missing since it was made: {_remedy(directory, stamp)}") from None
        if not unchanged:
            raise ValueError(f"{directory / name}: changed since it was made: {_remedy(directory, stamp)}")


def require_in_place(directory: Path, stamp: Stamp) -> None:
    """Refuse a directory whose `wav.scp` names the audio of another one: a copy, or one that lies elsewhere now.

    Raises
    ------
    ValueError
        Seen from the current folder, the place that the stamp states is not the directory.
    """
    if stamp.place and "wav.scp" in stamp.files and os.path.realpath(stamp.place) != os.path.realpath(directory):
        raise ValueError(f"{directory}: its wav.scp names audio in {stamp.place}, where the directory was made, and "
                         "from the current folder that is not this directory: go to the folder where it was made, or "
                         f"run {stamp.command} again for {directory}")


def require_audio_as_stamped(directory: Path, stamp: Stamp, found: dict[str, tuple[Path, str | None]]) -> None:
    """Refuse a directory that names audio elsewhere which is not as it was.

    Parameters
    ----------
    directory : Path
    stamp : Stamp
        Its stamp.
    found : dict
        Path and content hash of the audio that the directory names, by that name; None: there is no such file.

    Raises
    ------
    ValueError
        A file is missing or has changed.
    """
    remedy = f"run all steps that lead to {directory} again, from the first one"
    for name, content_hash in stamp.audio.items():
        path, now = found.get(name, (Path(name), None))
        if now is None:
            raise ValueError(f"{path}: missing since {directory} was made of it: {remedy}; if it was moved without the "
                             "audio that it refers to, move it back and copy it with roomeq export roomeq, which takes "
                             "RIRs and noises")
        if now != content_hash and hash_file(path) != content_hash:  # the hash may be a kept one, and wrong
            raise ValueError(f"{path}: changed since {directory} was made of it: {remedy}")


def _remedy(directory: Path, stamp: Stamp) -> str:
    return f"run {stamp.command} again, or remove {directory / DONE_FILE} to use {directory} as it is"


def check_output(out: Path, step: str, inputs: list[Path]) -> None:
    """Refuse an output that cannot be made, or that would replace something that this step did not make.

    Raises
    ------
    ValueError
        `out` cannot name a directory, is a link, a mount point or a file, was made by somebody else or by another step,
        or an input lies in it.
    """
    if not out.name or out.name == ".." or any(c in str(out) for c in "\n\r\0"):
        raise ValueError(f"output {str(out)!r} must name a directory to make, without line breaks: choose another")
    if out.is_symlink():
        raise ValueError(f"{out}: is a link, and would be replaced: give the directory that it leads to "
                         "(directories above may be links)")
    if os.path.ismount(out):
        raise ValueError(f"{out}: is a mount point, which cannot be replaced: give a directory in it")
    for path in inputs:
        if _lies_in(path, out):
            raise ValueError(f"{out}: input {path} lies in it and would be lost: choose another output")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    stamp = _read_any_format(out) if out.is_dir() else None
    if stamp is None:
        raise ValueError(f"{out}: exists and was not made by roomeq (no {DONE_FILE} in it): "
                         "choose another output, or move it away")
    if stamp.step != step:
        raise ValueError(f"{out}: was made by another step ({stamp.step}, not {step}): choose another output, or "
                         "remove it")


def _lies_in(path: Path, directory: Path) -> bool:
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(directory))
