"""Far-field data directories from clean ones: reverberate, add noise, keep the duration of every utterance.

Utterances are planned into recordings (`roomeq.augment.pack`), and each recording is one item of a `Build`. What is
drawn for an utterance is in `roomeq.augment.draw`, the signal processing in `roomeq.augment.mix`.
"""

import logging
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roomeq.augment.audio_cache import AudioCache
from roomeq.augment.draw import DrawRules, parse_distribution, read_pool
from roomeq.augment.mix import MixedUtterance, convolve, mix
from roomeq.augment.pack import PlannedUtterance, file_name, plan_recordings, write_recording
from roomeq.augment.summary import SUMMARY_FILE, Summary, log_summary
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import read_json, read_jsonl, to_json, write_json, write_jsonl
from roomeq.kaldi.datadir import DataDir, read_data_dir
from roomeq.kaldi.validate import MAX_DURATION_ERROR_S
from roomeq.kaldi.wavscp import flac_entry, read_entry
from roomeq.kaldi.write import GRID_SAMPLES, OutUtterance, write_data_dir

logger = logging.getLogger(__name__)

ROWS_FILE = "augment.jsonl"
MAX_COPIES, MAX_POINT_NOISES = 1000, 100
_ROWS = ".rows"


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
                           max_point_noises, draw_rooms_equally, tuple(map(str, noises)), packing, seed, pipes)
    _check(config)
    flac_entry(str(out))  # refuse a path that wav.scp cannot name before hours of work
    options = {name: value for name, value in asdict(config).items()
               if name not in ("data_dir", "rir_dir", "noises", "pipes")}
    build = Build(Path(out), step="augment", options=options,
                  inputs=[Path(data_dir), Path(rir_dir), *map(Path, noises)])
    if not build.done:
        from_scratch, start_s = not build.work.exists(), time.monotonic()
        data = read_data_dir(Path(data_dir), pipes=pipes)
        _log_missing_noises(_augmenter(config, build.work))
        plan = plan_recordings(data, copies, pipes=pipes)
        if not build.run(plan, partial(_make_recording, config, build.work), part=part, nj=nj):
            return None
        elapsed_s = time.monotonic() - start_s if from_scratch else None
        build.finish(partial(_assemble, config, build.work, data, build.out))
        log_summary(build.out, elapsed_s)
    shutil.rmtree(build.out / _ROWS, ignore_errors=True)
    return read_json(build.out / SUMMARY_FILE)


def _check(config: AugmentConfig) -> None:
    if not 1 <= config.copies <= MAX_COPIES:
        raise ValueError(f"copies={config.copies} must be at least 1 and at most {MAX_COPIES}")
    if not 0 <= config.point_noise_prob <= 1:
        raise ValueError(f"point_noise_prob={config.point_noise_prob} must lie in [0, 1]")
    if not 0 <= config.max_point_noises <= MAX_POINT_NOISES:
        raise ValueError(f"max_point_noises={config.max_point_noises} must lie in [0, {MAX_POINT_NOISES}]")
    if config.packing not in ("recording", "utterance"):
        raise ValueError(f"packing={config.packing!r} must be 'recording' or 'utterance'")
    parse_distribution(config.snr_db, "snr_db")
    parse_distribution(config.point_snr_db, "point_snr_db")


class _Augmenter:
    """State of one process. None of it grows with the number of utterances."""

    def __init__(self, config: AugmentConfig) -> None:
        self.config = config
        self.pool = read_pool(Path(config.rir_dir), [Path(path) for path in config.noises])
        self.rules = DrawRules(config.seed, config.draw_rooms_equally, parse_distribution(config.snr_db, "snr_db"),
                               parse_distribution(config.point_snr_db, "point_snr_db"), config.point_noise_prob,
                               config.max_point_noises)
        self.cache = AudioCache(Path(config.rir_dir), self.pool)

    def augment(self, planned: PlannedUtterance) -> tuple[MixedUtterance, dict]:
        """Return one far-field utterance and its row of `augment.jsonl`, which states all draws."""
        utterance, where = planned.clean, f"{self.config.data_dir}: utterance {planned.clean.id}"
        try:
            clean = read_entry(planned.entry, utterance.start_s, utterance.end_s, pipes=self.config.pipes)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
        length_s = len(clean) / FS_HZ
        if planned.stated_s is not None and abs(length_s - planned.stated_s) > MAX_DURATION_ERROR_S:
            raise ValueError(f"{where}: {planned.entry.text} lasts {length_s:.3f} s where utt2dur says "
                             f"{planned.stated_s:.3f} s: prepare the directory again, or put the right audio there")
        rir_id, draws = self.rules.draw(planned.id, self.pool)
        rir, shift = self.cache.rir(rir_id)
        reverberated = convolve(clean, rir, shift, len(clean))
        excerpts = [self.cache.noise(draw, len(clean)) for draw in draws]
        try:
            mixed = mix(clean, reverberated, [(excerpt.samples, draw.snr_db)
                                              for excerpt, draw in zip(excerpts, draws, strict=True)])
        except ValueError as error:
            drawn = ", ".join([f"RIR {rir_id}", *(f"noise {draw.noise.id}" for draw in draws)])
            raise ValueError(f"{where} with {drawn}: {error}") from None
        return mixed, dict(
            id=planned.id, clean=utterance.id, speaker=utterance.speaker, n_samples=len(clean), rir=rir_id,
            room=self.pool.rows[rir_id]["room_id"], shift=shift,
            noises=[dict(id=draw.noise.id, kind=draw.noise.kind, rir=draw.rir_id, start=excerpt.start,
                         snr_db=round(draw.snr_db, 4)) for excerpt, draw in zip(excerpts, draws, strict=True)],
            snr_db=None if mixed.snr_db is None else round(mixed.snr_db, 4),
            gain_db=round(mixed.gain_db, 4), peak_gain_db=round(mixed.peak_gain_db, 4))


@lru_cache(maxsize=1)
def _augmenter(config: AugmentConfig, work: Path) -> _Augmenter:
    """Return the state of this process for one build; `work` changes with the content of the inputs."""
    return _Augmenter(config)


def _log_missing_noises(augmenter: _Augmenter) -> None:
    pool, rules = augmenter.pool, augmenter.rules
    for noises, snr, kind in ((pool.ambient, rules.ambient_snr, "ambient"), (pool.point, rules.point_snr, "point")):
        if snr and not noises:
            logger.info("%s: no %s noises given: none are added", augmenter.config.rir_dir, kind)


def _make_recording(config: AugmentConfig, work: Path, name: str, utterances: list[PlannedUtterance]) -> dict:
    """Augment the utterances of one recording; write its audio below `work`, and their rows for `_assemble`."""
    augmenter = _augmenter(config, work)
    rows, files, pieces, position = [], [], [], 0
    for planned in utterances:
        mixed, row = augmenter.augment(planned)
        pcm = np.rint(mixed.samples * 32768).astype(np.int16)
        if config.packing == "utterance":
            row.update(recording=planned.id, start=0)
            files.append(write_recording(work, row["speaker"], planned.id, [pcm]))
        else:
            row.update(recording=name, start=position)
            gap = -len(pcm) % GRID_SAMPLES
            pieces += [pcm, np.zeros(gap, np.int16)]
            position += len(pcm) + gap
        rows.append(row)
    if pieces:
        files.append(write_recording(work, rows[0]["speaker"], name, pieces[:-1]))  # no gap after the last utterance
    write_jsonl(work / _ROWS / f"{file_name(name)}.jsonl", rows)
    return dict(files=files, rows=f"{file_name(name)}.jsonl")


def _assemble(config: AugmentConfig, work: Path, data: DataDir, out: Path, directory: Path,
              records: list[dict]) -> None:
    """Write the tables of the whole directory, streaming over the rows of all recordings."""
    recordings = {file["recording"]: (flac_entry(str(out / file["file"])), file["n_samples"])
                  for record in records for file in record["files"]}
    summary = Summary()
    with open(directory / ROWS_FILE, "w", encoding="utf-8", newline="\n") as stream:
        def utterances() -> Iterator[OutUtterance]:
            for record in records:
                for row in read_jsonl(directory / _ROWS / record["rows"]):
                    stream.write(to_json(row) + "\n")
                    summary.add(row)
                    yield OutUtterance(
                        row["id"], row["speaker"], row["recording"], row["start"], row["n_samples"],
                        text=data.text[row["clean"]] if data.text else None, rir=row["rir"],
                        snr_db="inf" if row["snr_db"] is None else f"{row['snr_db']:.2f}",
                        uniq=data.utt2uniq.get(row["clean"], row["clean"]))

        write_data_dir(directory, recordings, utterances(), spk2gender=data.spk2gender,
                       segmented=config.packing == "recording")
    write_json(directory / SUMMARY_FILE, summary.as_dict(_augmenter(config, work).pool, len(recordings)))
    read_data_dir(directory)
