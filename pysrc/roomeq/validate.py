"""Say whether directories keep their contracts."""

from pathlib import Path

from roomeq.core.files import hash_file
from roomeq.core.stamps import read_stamp
from roomeq.kaldi.datadir import validate_data_dir
from roomeq.records.rir_dir import NOISES_FILE, ROWS_FILE, validate_noises, validate_rirs
from roomeq.wer.check import WER_FILE, validate_wer

CONTRACTS = ((ROWS_FILE, validate_rirs, "RIRs"), ("wav.scp", validate_data_dir, "utterances"),
             (NOISES_FILE, validate_noises, "noises"), (WER_FILE, validate_wer, "systems"))
"""By the file that tells a directory's kind: what checks it whole and counts what is in it, and what that is."""


def validate(directories: list[Path]) -> None:
    """Check directories of RIRs, noises, the loop, Kaldi data and word error rates whole; print one line for each.

    Parameters
    ----------
    directories : list of Path

    Raises
    ------
    ValueError
        The first thing that is wrong.
    """
    for directory in map(Path, directories):
        for name, check, counted in CONTRACTS:
            if (directory / name).is_file():
                print(f"{directory}: {check(directory)} {counted}, all well")
                break
        else:
            _validate_loop(directory)
        check_stamp(directory)


def _validate_loop(directory: Path) -> None:
    from roomeq.loop.check import LEDGER_FILE, validate_loop  # takes a second that nothing else needs

    if not (directory / LEDGER_FILE).is_file():
        raise ValueError(f"{directory}: neither an RIR directory ({ROWS_FILE}), nor one of noises ({NOISES_FILE}), nor "
                         f"a data directory (wav.scp), nor one of the loop ({LEDGER_FILE}) or of word error rates "
                         f"({WER_FILE}): check the path")
    print(f"{directory}: {validate_loop(directory)} effects found, all well")


def check_stamp(directory: Path) -> None:
    """Compare every file of a directory that roomeq made with the hash it had then.

    Raises
    ------
    ValueError
        A file is missing or has changed.
    """
    for name, (_, digest) in read_stamp(directory).get("files", {}).items():
        path = directory / name
        if not path.is_file():
            raise ValueError(f"{path}: missing since it was made: make {directory} again")
        if hash_file(path) != digest:
            raise ValueError(f"{path}: changed since it was made: make {directory} again")
