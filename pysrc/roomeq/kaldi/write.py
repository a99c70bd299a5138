"""Write Kaldi data directories that `validate_data_dir.sh` accepts."""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, TextIO

from roomeq.core.constants import FS_HZ
from roomeq.core.files import errors_naming

GRID_SAMPLES = FS_HZ // 100
"""Grid on which segments start: 10 ms, Kaldi's frame shift."""

Append = Callable[[str, str], None]
"""Appends text to the table of a name."""


class OutUtterance(NamedTuple):
    """One utterance to write: lines of `segments`, `utt2spk`, `text`, ...

    `start` and `n_samples` are at `FS_HZ`. Each of `text`, `rir`, `snr_db`, `uniq` and `lang` is None either for
    all utterances or for none.
    """

    id: str
    speaker: str
    recording: str
    start: int
    n_samples: int
    text: str | None = None
    rir: str | None = None
    snr_db: str | None = None
    uniq: str | None = None
    lang: str | None = None


def format_seconds(n_samples: int) -> str:
    """Return a time in seconds with as many decimals as it needs to be exact.

    Seven are enough, since 1/16000 s has seven. At least two are written: ``"0.00"``, ``"12.3450625"``.
    """
    unit = 10_000_000 // FS_HZ
    whole, fraction = divmod(n_samples * unit, 10_000_000)
    digits = f"{fraction:07d}".rstrip("0")
    return f"{whole}.{digits:0<2}"


def write_data_dir(directory: Path, recordings: dict[str, tuple[str, int]], utterances: Iterable[OutUtterance], *,
                   spk2gender: dict[str, str] | None = None, segmented: bool = True) -> int:
    """Write the files of a Kaldi data directory; only the recordings are held in memory.

    Writes `wav.scp reco2dur utt2spk spk2utt utt2dur`, and `segments text utt2rir utt2snr utt2uniq utt2lang
    spk2gender` if there are values for them.

    Parameters
    ----------
    recordings
        By recording id: the `wav.scp` entry and the length [samples at `FS_HZ`].
    utterances
        Sorted by id and, in the same order, by speaker (both in byte order).
    spk2gender
        ``"m"`` or ``"f"`` by speaker; not written unless it holds every speaker.
    segmented
        Whether utterances are segments; if not, each is the whole recording of the same id.

    Returns
    -------
    n_utterances : int

    Raises
    ------
    ValueError
        The utterances are not sorted or there are none.
    """
    directory, n_utterances = Path(directory), 0
    speakers: list[str] = []
    with _open_tables(directory) as append:
        for utterance in _checked_order(utterances):
            n_utterances += 1
            _append_utterance(append, utterance, segmented)
            if not speakers or speakers[-1] != utterance.speaker:
                append("spk2utt", ("\n" if speakers else "") + utterance.speaker)
                speakers.append(utterance.speaker)
            append("spk2utt", f" {utterance.id}")
        if not n_utterances:
            raise ValueError(f"{directory}: no utterances to write: check the input directory")
        append("spk2utt", "\n")
        for recording, (entry, length) in sorted(recordings.items()):
            append("wav.scp", f"{recording} {entry}\n")
            append("reco2dur", f"{recording} {format_seconds(length)}\n")
        if spk2gender and all(speaker in spk2gender for speaker in speakers):
            append("spk2gender", "".join(f"{speaker} {spk2gender[speaker]}\n" for speaker in speakers))
    return n_utterances


def _append_utterance(append: Append, utterance: OutUtterance, segmented: bool) -> None:
    if segmented:
        append("segments", f"{utterance.id} {utterance.recording} {format_seconds(utterance.start)} "
                           f"{format_seconds(utterance.start + utterance.n_samples)}\n")
    for name, value in (("utt2spk", utterance.speaker), ("utt2dur", format_seconds(utterance.n_samples)),
                        ("text", utterance.text), ("utt2rir", utterance.rir),
                        ("utt2snr", utterance.snr_db), ("utt2uniq", utterance.uniq), ("utt2lang", utterance.lang)):
        if value is not None:
            append(name, f"{utterance.id} {value}\n")


def _checked_order(utterances: Iterable[OutUtterance]) -> Iterator[OutUtterance]:
    previous = None
    for utterance in utterances:
        if previous and (utterance.id <= previous.id or utterance.speaker < previous.speaker):
            raise ValueError(f"utterance {utterance.id!r} of {utterance.speaker!r} after {previous.id!r} of "
                             f"{previous.speaker!r}: must be sorted, each once, and by speaker alike: "
                             "make the speaker id the start of the utterance id")
        previous = utterance
        yield utterance


@contextlib.contextmanager
def _open_tables(directory: Path) -> Iterator[Append]:
    """Yield a function that appends to a table; the files appear once all of them are complete."""
    directory.mkdir(parents=True, exist_ok=True)
    streams: dict[str, TextIO] = {}

    def temporary(name: str) -> Path:
        return directory / f".{name}.{os.getpid()}.tmp"

    def append(name: str, text: str) -> None:
        if name not in streams:
            streams[name] = stack.enter_context(open(temporary(name), "w", encoding="utf-8", newline="\n"))
        streams[name].write(text)

    try:
        with errors_naming(directory), contextlib.ExitStack() as stack:
            yield append
        for name in streams:
            os.replace(temporary(name), directory / name)
    finally:
        for name in streams:
            temporary(name).unlink(missing_ok=True)
