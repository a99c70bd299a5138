"""Check that directories keep their contracts."""

from collections.abc import Iterable
from pathlib import Path

from roomeq.core.digests import audio_elsewhere
from roomeq.core.stamps import read_stamp, require_as_stamped, require_audio_as_stamped, require_in_place
from roomeq.kaldi import validate_data_dir
from roomeq.records.rir_dir import (
    NOISES_FILE,
    ROWS_FILE,
    read_rirs,
    validate_noises,
    validate_rirs,
    warn_of_unused_keys,
)
from roomeq.wer.check import WER_FILE, validate_wer

CONTRACTS = ((ROWS_FILE, validate_rirs, "RIRs"), ("wav.scp", validate_data_dir, "utterances"),
             (NOISES_FILE, validate_noises, "noises"), (WER_FILE, validate_wer, "systems"))
"""The file that tells a directory's kind, the function that checks the directory and counts its items, their name."""


def validate(directories: Iterable[Path]) -> None:
    """Check directories of RIRs, noises, Kaldi data, the loop and word error rates; print one line for each.

    Parameters
    ----------
    directories
        Any mixture of kinds; the kind of each is recognised by its files.

    Raises
    ------
    ValueError
        A directory breaks its contract, or is of no known kind. The first problem is named.
    """
    for directory in map(Path, directories):
        read_stamp(directory)  # refuses the formats of another version, which the checks would call broken
        for name, check, items in CONTRACTS:
            if (directory / name).is_file():
                found = f"{check(directory)} {items}"
                if name == ROWS_FILE:
                    warn_of_unused_keys(directory, read_rirs(directory))
                break
        else:
            found = f"{_validate_loop(directory)} effects"
        check_stamp(directory)
        print(f"{directory}: {found}, OK")


def _validate_loop(directory: Path) -> int:
    from roomeq.loop.ledger import LEDGER_FILE, validate_loop  # its import takes a second

    if not (directory / LEDGER_FILE).is_file():
        raise ValueError(f"{directory}: neither an RIR directory ({ROWS_FILE}), nor one of noises ({NOISES_FILE}), nor "
                         f"a data directory (wav.scp), nor one of the loop ({LEDGER_FILE}) or of word error rates "
                         f"({WER_FILE}): check the path")
    return validate_loop(directory)


def check_stamp(directory: Path) -> None:
    """Check that the files of a directory, and audio that it refers to, are as they were when it was made.

    Raises
    ------
    ValueError
        A file is missing or has changed, or audio that the directory refers to.
    """
    if stamp := read_stamp(directory):
        require_in_place(directory, stamp)
        require_as_stamped(directory, stamp, quick=False)
        require_audio_as_stamped(directory, stamp, audio_elsewhere(directory))
