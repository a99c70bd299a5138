"""Files that are whole or absent: atomic writing, JSON lines, hashes."""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file under a temporary name and rename it, so that nobody ever sees half of it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """`write_bytes` for UTF-8 text."""
    write_bytes(path, text.encode())


def to_json(value, indent: int | None = None) -> str:
    """Serialise to JSON with sorted keys; NaN and infinity are refused (they are not JSON)."""
    return json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=indent)


def write_json(path: Path, value) -> None:
    """Write one JSON document a person can read."""
    write_text(path, to_json(value, indent=1) + "\n")


def read_json(path: Path):
    """Read one JSON document.

    Raises
    ------
    ValueError
        The file is not UTF-8 JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not a JSON file ({error}): make it again") from None


def write_jsonl(path: Path, rows: Iterable[dict]) -> None:
    """Write one JSON object a line."""
    write_text(path, "".join(to_json(row) + "\n" for row in rows))


def read_jsonl(path: Path) -> list[dict]:
    """Read one JSON object a line.

    Raises
    ------
    ValueError
        A line is not a JSON object; the message names file and line.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file: check the path, or run the step that makes it")
    rows = []
    with open(path, encoding="utf-8", newline="\n") as stream:
        try:
            for number, line in enumerate(stream, start=1):
                rows.append(_json_object(line, f"{path}:{number}"))
        except UnicodeDecodeError as error:
            raise ValueError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    return rows


def _json_object(line: str, where: str) -> dict:
    try:
        value = json.loads(line)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{where}: not JSON ({error}): correct the line or make the file again") from None
    if not isinstance(value, dict):
        raise ValueError(f"{where}: {line.strip()[:60]!r} must be a JSON object")
    return value


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hex."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
