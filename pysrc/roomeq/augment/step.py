"""The step that makes far-field data directories. What it computes with is imported where there is work to do."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from roomeq.augment.distribution import parse_distribution
from roomeq.core.build import Build
from roomeq.core.constants import is_number, is_whole
from roomeq.core.files import paths, read_json

SUMMARY_FILE = "summary.json"
ROWS_FOLDER = ".rows"
"""Folder of the rows of each recording, in the directory until it is complete."""
MAX_COPIES, MAX_POINT_NOISES = 1000, 100


@dataclass(frozen=True)
class AugmentConfig:
    """Arguments of `augment` that worker processes need."""

    data_dir: str
    rir_dir: str
    copies: int
    snr_db: str
    point_snr_db: str
    point_noise_prob: float
    max_point_noises: int
    draw_rooms_equally: bool
    noises: tuple[str, ...]
    packing: str
    seed: int
    pipes: bool


def augment(data_dir: Path | str, rir_dir: Path | str, out: Path | str, *, seed: int = 0, copies: int = 1,
            snr_db: str = "uniform 5 25", point_snr_db: str = "uniform 5 25", point_noise_prob: float = 0.5,
            max_point_noises: int = 1, noises: Sequence[Path | str] = (), draw_rooms_equally: bool = False,
            packing: str = "recording", pipes: bool = False, part: str | None = None, nj: int = 1) -> dict | None:
    """Make a far-field data directory out of a clean one: x_r = x*h_s + sum n_i*h_i + d (Tang et al., eq. 1).

    The delay of the RIR's direct sound is removed, so that labels of the clean speech stay aligned, and the duration
    is that of the clean speech to the sample. RIR, noises, SNRs and offsets depend on the seed and the utterance id
    alone, not on order or jobs.

    Parameters
    ----------
    data_dir
        Kaldi data directory with the clean speech.
    rir_dir
        RIR directory; noises are those of its `noises.jsonl`. RIRs with `noise_for` are used for noises only.
    out
        Data directory to make; `wav.scp` names its audio by this path.
    copies
        Far-field versions of each utterance. With more than one, ids get the suffix ``-rvb1``, ``-rvb2``, ...
    snr_db, point_snr_db
        SNR [dB] of the ambient noise d and of each point noise n_i: ``"uniform 5 25"``, ``"normal 15 5"``,
        ``"list 20,15,10"``, a number, or ``"none"`` for no such noise.
    point_noise_prob
        Probability of each of the `max_point_noises` point noises. The RIR of a point noise is one simulated for it,
        else another RIR of the same room, with another source position if there is one. An RIR that is alone in its
        room gets no point noise.
    max_point_noises
        Largest number of point noises in an utterance.
    noises
        Further directories with `noises.jsonl`, as `roomeq read-noises` makes them. ``ambient`` noises are added as
        they are, preferably one of the RIR's own room; ``point`` noises are convolved with an RIR.
    draw_rooms_equally
        Draw the room first, then one of its RIRs; by default every RIR is equally likely.
    packing
        ``"recording"``: one FLAC per chapter (or per speaker, at most 15 minutes) with `segments`;
        ``"utterance"``: one FLAC per utterance.
    pipes
        Run the commands in the `wav.scp` of the clean directory; without it they are refused.
    part
        ``"2/5"``: do the second of five shares only; a last call without `part` finishes.
    nj
        Number of processes.

    Returns
    -------
    summary : dict or None
        Content of `summary.json`: utterances, hours, RIRs used, SNR histogram, ... None after a `part`.

    Raises
    ------
    ValueError
        An option is out of range, or the data directory, an RIR or a noise breaks its contract.
    """
    config = AugmentConfig(str(data_dir), str(rir_dir), copies, snr_db, point_snr_db, point_noise_prob,
                           max_point_noises, draw_rooms_equally, tuple(map(str, paths(noises))), packing, seed, pipes)
    _check(config)
    options = {name: value for name, value in asdict(config).items()
               if name not in ("data_dir", "rir_dir", "noises", "pipes")}
    build = Build(Path(out), step="augment", options=options,
                  inputs=[Path(data_dir), Path(rir_dir), *paths(noises)])
    if not build.done:
        from roomeq.augment.far_field import make

        if not make(build, config, part, nj):
            return None
    shutil.rmtree(build.out / ROWS_FOLDER, ignore_errors=True)
    return read_json(build.out / SUMMARY_FILE)


def _check(config: AugmentConfig) -> None:
    for name in ("seed", "copies", "max_point_noises"):
        if not is_whole(value := getattr(config, name)):
            raise ValueError(f"{name}={value!r} must be a whole number: correct it")
    if not 1 <= config.copies <= MAX_COPIES:
        raise ValueError(f"copies={config.copies} must be at least 1 and at most {MAX_COPIES}")
    if not (is_number(config.point_noise_prob) and 0 <= config.point_noise_prob <= 1):
        raise ValueError(f"point_noise_prob={config.point_noise_prob!r} must lie in [0, 1]")
    if not 0 <= config.max_point_noises <= MAX_POINT_NOISES:
        raise ValueError(f"max_point_noises={config.max_point_noises} must lie in [0, {MAX_POINT_NOISES}]")
    if config.packing not in ("recording", "utterance"):
        raise ValueError(f"packing={config.packing!r} must be 'recording' or 'utterance'")
    parse_distribution(config.snr_db, "snr_db")
    parse_distribution(config.point_snr_db, "point_snr_db")
