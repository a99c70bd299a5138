"""Replay of a loss of power: what a step does to the file system is recorded, and the disk set up as it may look then.

The record holds every creation, change of name, removal and sync of a run, with the content of files at each sync. At
any place in it, `disk_after` gives the files that a loss of power there leaves. What was synced is on the disk: the
content of a file, the names in a directory. Of all else, file systems write what they like in any order (Pillai et al.,
"All File Systems Are Not Created Equal", OSDI 2014). Three of them stand for all:

- ``nothing``: what was not synced is lost.
- ``names``: names and lengths are on the disk, as a journal of metadata has it; content that was not synced is zero.
- ``some``: each change of a name is kept or lost at random; content that was not synced is whole, zero, half or empty.
"""

import contextlib
import multiprocessing
import os
import pickle
import random
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

Op = tuple[str, ...]
"""Kind and paths of an operation, relative to the directory that is watched; ``("content", path, bytes)``."""
Files = dict[str, bytes | None]
"""Content of files by path; None for a directory."""

WRITING = os.O_WRONLY | os.O_RDWR


def record(act: Callable[[], None], root: Path, log: Path) -> list[Op]:
    """Run `act` in a process of its own and return what it did below `root`; `log` is a file elsewhere.

    Raises
    ------
    AssertionError
        `act` failed.
    """
    process = multiprocessing.get_context("fork").Process(target=_record_here, args=(act, root, log))
    process.start()
    process.join()
    assert process.exitcode == 0, f"exit {process.exitcode}"
    return pickle.loads(log.read_bytes())


def _record_here(act: Callable[[], None], root: Path, log: Path) -> None:
    ops: list[Op] = []
    sync = os.fsync

    def name_of(path, folder=-1) -> str | None:
        """Return a path relative to the root, or None where it lies elsewhere or is an open file."""
        if isinstance(path, int):
            return None
        path = os.fsdecode(path)
        if folder != -1:
            path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), path)
        path = os.path.abspath(path)
        return os.path.relpath(path, root) if path.startswith(f"{root}/") else None

    def note_content(name: str) -> None:
        path = root / name
        if path.is_file() and not path.is_symlink():
            ops.append(("content", name, path.read_bytes()))

    def hook(event: str, args: tuple) -> None:
        if event == "open" and args[2] & (WRITING | os.O_CREAT) and (name := name_of(args[0])):
            ops.append(("create", name))
        elif event == "os.mkdir" and (name := name_of(args[0], args[2])):
            ops.append(("mkdir", name))
        elif event in ("os.remove", "os.rmdir") and (name := name_of(args[0], args[1])):
            ops.append(("remove", name))
        elif event == "os.rename":
            old, new = name_of(args[0], args[2]), name_of(args[1], args[3])
            if old and new:
                note_content(old)
                ops.append(("rename", old, new))
        elif event in ("os.truncate", "os.link", "os.symlink") and name_of(args[0]):
            raise NotImplementedError(event)

    def fsync(descriptor: int) -> None:
        name = os.path.relpath(os.readlink(f"/proc/self/fd/{descriptor}"), root)
        note_content(name)
        sync(descriptor)
        ops.append(("sync", name))

    sys.addaudithook(hook)
    os.fsync = fsync
    act()
    os.fsync = sync
    for name, content in files_of(root).items():
        if content is not None:
            ops.append(("content", name, content))
    log.write_bytes(pickle.dumps(ops))


def files_of(root: Path) -> Files:
    """Return all files and directories below a directory."""
    return {str(path.relative_to(root)): None if path.is_dir() else path.read_bytes()
            for path in sorted(root.rglob("*"))}


@dataclass
class _Node:
    """A file or a directory, as it is and as it is on the disk."""

    is_dir: bool
    content: bytes = b""
    synced: bytes | None = None
    names: dict[str, "_Node"] = field(default_factory=dict)
    synced_names: dict[str, "_Node"] = field(default_factory=dict)
    pending: list[tuple[str | None, str, "_Node | None"]] = field(default_factory=list)
    """Changes of names since the last sync: the name that goes, the name that is set and to what (None: it goes)."""

    def change(self, old: str | None, new: str, node: "_Node | None") -> None:
        _apply(self.names, old, new, node)
        self.pending.append((old, new, node))

    def sync(self) -> None:
        self.synced, self.synced_names, self.pending = self.content, dict(self.names), []


def _apply(names: dict[str, _Node], old: str | None, new: str, node: _Node | None) -> None:
    if old is not None and names.get(old) is node:
        del names[old]
    if node is None:
        names.pop(new, None)
    else:
        names[new] = node


class Disk:
    """A directory and what of it is on the disk.

    Parameters
    ----------
    before : dict
        Its files, all of which are on the disk.
    """

    def __init__(self, before: Files) -> None:
        self.root = _Node(True)
        for name, content in before.items():
            node = _Node(content is None, content or b"")
            folder, last = self._folder(name)
            folder.names[last] = node
        for node in self._all(self.root):
            node.sync()

    def _all(self, node: _Node) -> Iterator[_Node]:
        yield node
        for inner in node.names.values():
            yield from self._all(inner)

    def _folder(self, name: str) -> tuple[_Node, str]:
        *folders, last = Path(name).parts
        node = self.root
        for each in folders:
            node = node.names[each]
        return node, last

    def do(self, op: Op) -> None:
        """Do an operation of a record; one that failed there fails here too, and does nothing."""
        with contextlib.suppress(KeyError):
            if op[0] == "sync" and op[1] == ".":
                return self.root.sync()
            folder, last = self._folder(op[1])
            if op[0] in ("mkdir", "create"):
                if last not in folder.names:
                    folder.change(None, last, _Node(op[0] == "mkdir"))
            elif op[0] == "content":
                folder.names[last].content = op[2]
            elif op[0] == "sync":
                folder.names[last].sync()
            elif op[0] == "rename":
                into, new = self._folder(op[2])
                assert into is folder, f"{op}: a change of directory is not modelled"
                folder.change(last, new, folder.names[last])
            elif not folder.names[last].names:  # a directory that is not empty is not removed
                folder.change(None, last, None)

    def files(self) -> Files:
        """Return the files as a program sees them."""
        return dict(_walk(self.root, lambda node: node.names, lambda node: node.content))

    def on_disk(self, kept: str, rng: random.Random) -> Files:
        """Return the files as they are found after a loss of power; `kept` of what was not synced (see the module)."""
        def names(node: _Node) -> dict[str, _Node]:
            found = dict(node.synced_names)
            for change in node.pending:
                if kept == "names" or (kept == "some" and rng.random() < 0.5):
                    _apply(found, *change)
            return found

        def content(node: _Node) -> bytes:
            size, synced = len(node.content), node.synced or b""
            if kept == "nothing" or node.synced == node.content:
                return synced
            zeros = bytes(size)
            if kept == "names":
                return zeros
            return rng.choice([synced, node.content, zeros, node.content[:size // 2] + zeros[size // 2:], b""])
        return dict(_walk(self.root, names, content))


def _walk(node: _Node, names: Callable[[_Node], dict[str, _Node]], content: Callable[[_Node], bytes],
          prefix: str = "") -> Iterator[tuple[str, bytes | None]]:
    for name, inner in sorted(names(node).items()):
        yield f"{prefix}{name}", None if inner.is_dir else content(inner)
        if inner.is_dir:
            yield from _walk(inner, names, content, f"{prefix}{name}/")


def disk_after(before: Files, ops: list[Op], kept: str, rng: random.Random) -> Files:
    """Return what is on the disk if the power fails after some operations on the files `before`."""
    disk = Disk(before)
    for op in ops:
        disk.do(op)
    return disk.on_disk(kept, rng)
