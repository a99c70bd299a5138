"""Files that are complete or absent: atomic writing, JSON, JSON lines, hashes."""

import contextlib
import errno
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from roomeq.core.constants import is_number, is_whole

Paths = Path | str | Sequence[Path | str]
"""One path or several."""

FileState = tuple[int, str]
"""Size of a file [bytes] and SHA-256 of its content, in hex."""

_listings: list[dict[Path, FileState]] = []


def paths(given: Paths) -> list[Path]:
    """Return one path or several as a list."""
    return [Path(given)] if isinstance(given, Path | str) else [Path(path) for path in given]


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file under a temporary name and rename it, so that no reader sees half of it.

    Its content is on the disk before it has its name, so that a loss of power does not leave half of it either.

    Raises
    ------
    OSError
        The file cannot be written, for instance because the disk is full; the error names `path`.
    """
    path = Path(path)
    with _replacing(path) as temporary, open(temporary, "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    if _listings:
        state = len(data), hashlib.sha256(data).hexdigest()
        for listing in _listings:
            listing[path] = state


@contextlib.contextmanager
def listing_written() -> Iterator[dict[Path, FileState]]:
    """Yield a dict that takes up every file which this process writes with `write_bytes` within the block."""
    listing: dict[Path, FileState] = {}
    _listings.append(listing)
    try:
        yield listing
    finally:
        _listings[:] = [other for other in _listings if other is not listing]


def sync(path: Path) -> None:
    """Wait until a file's content, or the names in a directory, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems cannot sync a directory
            raise
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it is renamed to `path` when the block ends, and removed when it fails."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with errors_naming(path, temporary):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def errors_naming(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Let an `OSError` that names no file, or a temporary one, name `path`."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from None


def write_sealed(path: Path, body: str) -> None:
    """Write a text with a hash of it in the first line."""
    write_text(path, f"{_seal(body.encode(errors='surrogateescape'))}\n{body}")


def read_sealed(path: Path) -> str | None:
    """Return a text that `write_sealed` wrote, or None where the file is absent or damaged."""
    try:
        stated, body = path.read_bytes().split(b"\n", 1)
    except (OSError, ValueError):
        return None
    return body.decode() if stated == _seal(body).encode() else None


def _seal(body: bytes) -> str:
    return hashlib.sha256(body).hexdigest()


def write_text(path: Path, text: str) -> None:
    """`write_bytes` for UTF-8 text.

    Raises
    ------
    ValueError
        The text cannot be encoded, as a rule because it holds a file name in another encoding.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        around = text[max(0, error.start - 40):error.end + 20]
        raise ValueError(f"{path}: {around!r} cannot be written as UTF-8: rename the file or folder") from None
    write_bytes(path, data)


def read_text(path: Path) -> str:
    """Read UTF-8 text.

    Raises
    ------
    ValueError
        A byte is not UTF-8; the message names its line. Or it is a pipe or a device, which may never end.
    """
    path = Path(path)
    if not path.is_file() and path.exists() and not path.is_dir():
        raise ValueError(f"{path}: must be a regular file, no pipe or device: write a file")
    content = path.read_bytes()
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        number = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}:{number}: byte 0x{content[error.start]:02x} is not UTF-8: "
                         "convert the file") from None


def to_json(value: Any, indent: int | None = None) -> str:
    """Serialise to JSON with sorted keys, NumPy's numbers as plain ones; NaN and infinity, not in JSON, are refused."""
    return json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=indent, default=_plain)


def _plain(value: Any) -> int | float:
    if is_whole(value):
        return int(value)
    if is_number(value):
        return float(value)
    raise TypeError(f"{value!r} of type {type(value).__name__} is not JSON")


def write_json(path: Path, value: Any) -> None:
    """Write one JSON document, indented for people."""
    write_text(path, to_json(value, indent=1) + "\n")


def read_json(path: Path) -> Any:
    """Read one JSON document.

    Raises
    ------
    ValueError
        The file is not UTF-8 JSON.
    """
    text = read_text(path)
    try:
        return _from_json(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not a JSON file ({error}): make it again") from None


def write_jsonl(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write one JSON object per line."""
    write_text(path, "".join(to_json(dict(row)) + "\n" for row in rows))


def read_jsonl(path: Path) -> list[dict[str, Any]]:
    """Read one JSON object per line.

    Raises
    ------
    ValueError
        A line is not a JSON object; the message names file and line.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file: check the path, or run the step that makes it")
    with open(path, "rb") as stream:
        return [_json_object(line, f"{path}:{number}") for number, line in enumerate(stream, start=1)]


def _json_object(line: bytes, where: str) -> dict[str, Any]:
    try:
        value = _from_json(line.decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where}: not JSON ({error}): correct the line or make the file again") from None
    if not isinstance(value, dict):
        raise ValueError(f"{where}: {line.decode()[:60].strip()!r} must be a JSON object: correct the line or make "
                         "the file again")
    return value


def _from_json(text: str) -> Any:
    """Parse JSON; NaN and infinity, which are not JSON, and a key that occurs twice are refused."""
    return json.loads(text, parse_constant=_finite, parse_float=_finite, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key {twice[:60]!r} occurs twice: leave one out")
    return made


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"number {text[:20]} must be finite")
    return value


def user_cache() -> Path:
    """Return the directory for what may be deleted at any time; for a user without a home, one that cannot be made."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "roomeq"
    except RuntimeError:
        return Path(os.devnull) / "roomeq"


def physical(path: Path | str, resolve: Callable[[Path], str] = os.path.realpath) -> Path:
    """Return a path with the links above it resolved, as the system does: ``..`` leaves where a link leads to.

    If the path is itself a link, it is kept. For many paths at one time, `resolve` may remember folders.
    """
    path = Path(path)
    return Path(resolve(path.parent)) / path.name


def output_path(out: Path | str) -> Path:
    """Return the path of a directory to make without ``..`` after names, and as it was given otherwise.

    Where ``..`` follows a link, it leaves the directory that the link leads to: the result has links resolved.
    """
    shortened = Path(os.path.normpath(out))
    if "\0" in str(out):  # which no path holds; `Build` refuses it
        return shortened
    return shortened if os.path.realpath(shortened) == os.path.realpath(out) else physical(out)


def path_from(path: Path, out: Path) -> str:
    """Return the path of a file relative to the directory `out`, with links above both resolved."""
    return os.path.relpath(physical(path), physical(output_path(out)))


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hex."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
