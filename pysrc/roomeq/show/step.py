"""The functions behind `roomeq show` and `roomeq compare`. What they draw with is imported where there is work."""

import logging
import sys
from pathlib import Path

from roomeq.core.asking import NotUpToDate, only_asked
from roomeq.core.extras import require_packages
from roomeq.core.files import write_bytes

logger = logging.getLogger(__name__)

PAGE, PICTURE = ".html", ".png"


def show(path: Path, *, out: Path | None = None, ident: str | None = None, channel: int | None = None,
         speech: Path | None = None, keep_suspicious: bool = False) -> None:
    """Show an RIR, the RIRs of a directory, what a closed loop found, or a room: pictures, sound and numbers.

    Parameters
    ----------
    path : Path
        An RIR file of any sample rate from 8 to 48 kHz, an RIR directory, the output of ``roomeq close-loop``, or the
        mesh of a room.
    out : Path, optional
        Page (``.html``, with audio) or picture (``.png``) to make. Without it, the parameters are printed.
    ident : str, optional
        Id of the RIR of a directory to show; by default the page has one with the median DRR as an example.
    channel : int, optional
        Channel of a file with several, counted from 0.
    speech : Path, optional
        Recording of dry speech that the page plays through the RIRs, instead of noise bursts.
    keep_suspicious : bool
        Show recordings that are no RIR by their acoustics.

    Raises
    ------
    ValueError
        `path` is none of these, is no RIR, or has no RIR of this id; or `out` is neither a page nor a picture.
    """
    if only_asked():  # what is shown is made each time
        raise NotUpToDate(str(out))
    from roomeq.show.inputs import kind_of

    path, suffix = Path(path), _suffix(out)
    kind = kind_of(path)
    _require_fitting_options(path, kind, suffix, ident, channel, speech)
    if kind == "room":
        if speech is not None:
            raise ValueError(f"--speech {speech}: {path} is a mesh, which has no sound: leave --speech out")
        from roomeq.show.page_room import show_room

        _deliver(show_room(path, suffix), out)
        return
    if kind == "loop":
        from roomeq.show.page_loop import show_loop

        _deliver(show_loop(path, suffix, speech), out)
        return
    from roomeq.show import pages

    if kind == "set":
        content = pages.rir_set(path, suffix, ident, speech, keep_suspicious)
    else:
        content = pages.rir_file(path, suffix, channel, speech, keep_suspicious)
    _deliver(content, out)


def compare(first: Path, second: Path, *, out: Path | None = None, ident: str | None = None,
            channel: int | None = None, speech: Path | None = None, keep_suspicious: bool = False) -> None:
    """Compare two RIRs, or the RIRs of two directories, in just noticeable differences (JND).

    Parameters
    ----------
    first, second : Path
        Two RIR files, or two RIR directories. RIRs of directories are paired by id, or by the id of the measured RIR
        that a simulated one was made for; where no ids agree, the directories are compared as sets.
    out : Path, optional
        Page (``.html``, with audio) to make. Without it, the parameters of both are printed.
    ident : str, optional
        Id in `first` of the pair that the page shows; by default that of the median difference.
    channel : int, optional
        Channel of files with several, counted from 0.
    speech : Path, optional
        Recording of dry speech that the page plays through both RIRs, instead of noise bursts.
    keep_suspicious : bool
        Compare recordings that are no RIR by their acoustics.

    Raises
    ------
    ValueError
        The two are of different kinds or no RIRs, there is no such pair, or `out` is no page.
    """
    if only_asked():
        raise NotUpToDate(str(out))
    from roomeq.show.inputs import kind_of

    first, second, suffix = Path(first), Path(second), _suffix(out, pictures=False)
    kinds = kind_of(first), kind_of(second)
    if kinds not in (("rir", "rir"), ("set", "set")):
        raise ValueError(f"{first} and {second} must be two RIR files or two RIR directories: give two of one kind")
    _require_fitting_options(first, kinds[0], suffix, ident, channel, speech)
    from roomeq.show import pages

    if kinds[0] == "rir":
        content = pages.two_files(first, second, suffix, channel, speech, keep_suspicious)
    else:
        content = pages.two_sets(first, second, suffix, ident, speech, keep_suspicious)
    _deliver(content, out)


def _require_fitting_options(path: Path, kind: str, suffix: str | None, ident: str | None, channel: int | None,
                             speech: Path | None) -> None:
    if ident is not None and kind != "set":
        raise ValueError(f"--id {ident}: {path} is no RIR directory: leave --id out")
    if channel is not None and kind != "rir":
        raise ValueError(f"--channel {channel}: {path} is no audio file: leave --channel out")
    if speech is not None and suffix != PAGE:
        raise ValueError(f"--speech {speech}: is played on a page: give --out FILE{PAGE}")


def _suffix(out: Path | None, pictures: bool = True) -> str | None:
    """Return what to make: ".html", ".png", or None for text."""
    if out is None:
        return None
    suffix, allowed = Path(out).suffix.lower(), (PAGE, PICTURE) if pictures else (PAGE,)
    if suffix not in allowed:
        raise ValueError(f"--out {out}: must end in {' or '.join(allowed)}: choose another name")
    if not Path(out).absolute().parent.is_dir():
        raise ValueError(f"--out {out}: its directory does not exist: make it, or check the path")
    require_packages("matplotlib", *(["jinja2"] if suffix == PAGE else []))
    return suffix


def _deliver(content: bytes | str, out: Path | None) -> None:
    """Print a text, or write a page or a picture."""
    if out is None:
        encoding = sys.stdout.encoding or "utf-8"  # which may lack arrows, as names may hold bytes that are no UTF-8
        print(str(content).encode(encoding, "replace").decode(encoding))
        return
    write_bytes(Path(out), content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
    logger.info("wrote %s", out)
