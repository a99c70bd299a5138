"""What a loss of power does to files that were not yet on the disk, done on purpose."""

import os

import pytest

from roomeq.core.build import Build


def lost(path):
    """Take the file away: its directory was not on the disk."""
    path.unlink()


def emptied(path):
    """Leave a file without content: its blocks were not allocated."""
    os.truncate(path, 0)


def halved(path):
    """Cut the second half off."""
    os.truncate(path, path.stat().st_size // 2)


def zeroed(path):
    """Keep the size and lose the second half: its blocks were allocated and not written."""
    size = path.stat().st_size
    os.truncate(path, size // 2)
    os.truncate(path, size)


def flipped(path):
    """Change one bit in the middle."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGES = (lost, emptied, halved, zeroed, flipped)


class Killed(BaseException):
    """The end of a run."""


def run_until_assembled(step):
    """Run a step whose power fails after all items are made, before its directory is put in place."""
    def killed(build, assemble):
        raise Killed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Build, "finish", killed)
        with pytest.raises(Killed):
            step()


def work_directories(parent):
    """Return the directories under construction below a directory."""
    return sorted(path for path in parent.rglob(".*.part-*") if path.is_dir())


def whole_files(directory):
    """Return the content of all files below a directory by name, without those of roomeq's own."""
    return {str(path.relative_to(directory)): path.read_bytes() for path in sorted(directory.rglob("*"))
            if path.is_file() and not path.name.startswith(".") and "/." not in str(path.relative_to(directory))}
