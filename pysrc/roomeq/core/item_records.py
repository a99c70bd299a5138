"""Records of finished items: what the work returned, and which files it wrote with which content.

A loss of power may leave a file lost, empty or half written, and a record too. Files are on the disk before the record
that vouches for them, and both are told by their hashes: an item is finished if all of them are right.
"""

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.files import FileState, read_sealed, sync, to_json, write_sealed
from roomeq.core.kept_hashes import KeptHashes, quick_look


class ItemRecord(NamedTuple):
    """The record of an item.

    Attributes
    ----------
    result : JSON-able
    files : dict
        Size and hash of the files that the work wrote, by name relative to the directory.
    """

    result: Any
    files: dict[str, FileState]


def write_item_record(path: Path, work: Path, result: Any, written: dict[Path, FileState]) -> None:
    """Write a record, after the directories of the files that were written below `work` are on the disk."""
    files = {os.path.relpath(file, work): state for file, state in written.items() if file.is_relative_to(work)}
    for folder in sorted({Path(name).parent for name in files}):
        sync(work / folder)
    write_sealed(path, to_json(dict(result=result, files=files)))


def read_item_record(path: Path) -> ItemRecord | None:
    """Return a record, or None where it is absent or damaged."""
    body = read_sealed(path)
    if body is None:
        return None
    content = json.loads(body)
    return ItemRecord(content["result"], {name: (size, content_hash)
                                          for name, (size, content_hash) in content["files"].items()})


def is_complete(path: Path, work: Path, hashes: KeptHashes) -> bool:
    """Tell whether an item is finished: its record and all its files below `work` are as they were written."""
    record = read_item_record(path)
    return record is not None and all(is_as_recorded(work / name, state, hashes)
                                      for name, state in record.files.items())


def is_as_recorded(path: Path, state: FileState, hashes: KeptHashes) -> bool:
    """Tell whether a file has the size and the hash that were recorded."""
    look = quick_look(path)
    return look is not None and (look.size, hashes.of(path)) == state
