"""Far-field data directories from clean ones: reverberate, add noise, keep every utterance's duration.

One utterance is `roomeq.augment.mix`, what is drawn for it is `roomeq.augment.draw`; here is the way through a
whole data directory: utterances are planned into recordings, each recording is one item of a `Build`.
"""

import logging
import math
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roomeq.augment.audio_cache import Sounds
from roomeq.augment.draw import Pool, Rules, parse_distribution, read_pool
from roomeq.augment.mix import Mixture, convolve, mix
from roomeq.augment.pack import Planned, file_name, plan_recordings, write_recording
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.digests import audio_digest
from roomeq.core.files import read_json, read_jsonl, to_json, write_json, write_jsonl
from roomeq.corpora.record import is_generated
from roomeq.kaldi.datadir import DataDir, read_data_dir
from roomeq.kaldi.wavscp import flac_entry, read_entry
from roomeq.kaldi.write import GRID_SAMPLES, OutUtterance, write_data_dir

logger = logging.getLogger(__name__)

ROWS_FILE = "augment.jsonl"
SUMMARY_FILE = "summary.json"
MAX_COPIES, MAX_POINT_NOISES = 1000, 100
_ROWS = ".rows"


@dataclass(frozen=True)
class Job:
    """Everything a worker process needs to know; see `augment`."""

    data_dir: str
    rir_dir: str
    work: str
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


def augment(data_dir: Path, rir_dir: Path, out: Path, *, seed: int = 0, copies: int = 1,
            snr_db: str = "uniform 5 25", point_snr_db: str = "uniform 5 25", point_noise_prob: float = 0.5,
            max_point_noises: int = 1, noises: list[Path] = (), draw_rooms_equally: bool = False,
            packing: str = "recording", pipes: bool = False, part: str | None = None, nj: int = 1) -> dict | None:
    """Make a far-field data directory out of a clean one: x_r = x*h_s + sum n_i*h_i + d (Tang et al., eq. 1).

    The result is advanced by the RIR's direct sound, so it starts with the clean speech and has its duration to
    the sample. RIR, noises, SNRs and offsets depend on the seed and the utterance id alone, not on order or jobs.

    Parameters
    ----------
    data_dir : Path
        Kaldi data directory with the clean speech.
    rir_dir : Path
        RIR directory; its `noises.jsonl` gives noises. RIRs with `noise_for` carry noises only.
    out : Path
        Data directory to make; `wav.scp` names its audio by this path.
    seed : int
        Seed of all draws.
    copies : int
        Far-field versions of each utterance; with more than one, ids get the suffix ``-rvb1``, ``-rvb2``, ...
    snr_db, point_snr_db : str
        SNR [dB] of the ambient noise d and of each point noise n_i: ``"uniform 5 25"``, ``"normal 15 5"``,
        ``"list 20,15,10"``, a number, or ``"none"`` for no such noise.
    point_noise_prob : float
        Probability of each of the `max_point_noises` point noises. Its RIR is one simulated for it, else another
        of the same room, from another source position where there is one; an RIR alone in its room gets none.
    max_point_noises : int
        How many point noises an utterance may have.
    noises : list of Path
        Further directories with `noises.jsonl` (`roomeq read-noises` makes them): ``ambient`` ones are added as
        they are, one of the RIR's own room where there is any; ``point`` ones are convolved with an RIR.
    draw_rooms_equally : bool
        Choose the room first, then an RIR in it; by default every RIR is equally likely.
    packing : str
        ``"recording"``: one FLAC per chapter (or per speaker, at most 15 minutes) with `segments`;
        ``"utterance"``: one FLAC per utterance.
    pipes : bool
        Run the commands in the clean directory's `wav.scp`; without it they are refused.
    part : str, optional
        ``"2/5"``: do only the second of five shares; a last call without `part` finishes.
    nj : int
        Processes.

    Returns
    -------
    summary : dict or None
        What `summary.json` holds: utterances, hours, RIRs used, SNR histogram, ... None after a `part`.

    Raises
    ------
    ValueError
        An option, the data directory, an RIR or a noise is wrong; see the modules named above.
    """
    job = Job(str(data_dir), str(rir_dir), "", copies, snr_db, point_snr_db, point_noise_prob, max_point_noises,
              draw_rooms_equally, tuple(map(str, noises)), packing, seed, pipes)
    _check(job)
    flac_entry(str(out))  # refuses what wav.scp cannot name before hours of work
    options = {name: value for name, value in vars(job).items()
               if name not in ("data_dir", "rir_dir", "work", "noises", "pipes")}
    if not is_generated(Path(data_dir)):  # nobody else looked whether its audio has changed
        recordings = read_data_dir(Path(data_dir), pipes=pipes).recordings
        options["audio"] = audio_digest(Path(entry.text) for entry in recordings.values() if entry.kind != "pipe")
    build = Build(out, step="augment", options=options,
                  inputs=[Path(data_dir), Path(rir_dir), *map(Path, noises)])
    if not build.done:
        job = Job(**{**vars(job), "work": str(build.work)})
        fresh, began = not build.work.exists(), time.monotonic()
        data = read_data_dir(Path(data_dir), pipes=pipes)
        plan = plan_recordings(data, copies, pipes=pipes)
        _say_what_is_missing(_session(job))
        if not build.run(plan, partial(_make_recording, job), part=part, nj=nj):
            return None
        took_s = time.monotonic() - began if fresh else None
        build.finish(partial(_assemble, job, data, build.out))
        _log_summary(build.out, took_s)
    shutil.rmtree(build.out / _ROWS, ignore_errors=True)
    return read_json(build.out / SUMMARY_FILE)


def _check(job: Job) -> None:
    if not 1 <= job.copies <= MAX_COPIES:
        raise ValueError(f"copies={job.copies} must be at least 1 and at most {MAX_COPIES}")
    if not 0 <= job.point_noise_prob <= 1:
        raise ValueError(f"point_noise_prob={job.point_noise_prob} must lie in [0, 1]")
    if not 0 <= job.max_point_noises <= MAX_POINT_NOISES:
        raise ValueError(f"max_point_noises={job.max_point_noises} must lie in [0, {MAX_POINT_NOISES}]")
    if job.packing not in ("recording", "utterance"):
        raise ValueError(f"packing={job.packing!r} must be 'recording' or 'utterance'")
    parse_distribution(job.snr_db, "snr_db")
    parse_distribution(job.point_snr_db, "point_snr_db")


class _Session:
    """What one process keeps while it works on a job: nothing that grows with the number of utterances."""

    def __init__(self, job: Job):
        self.job = job
        self.pool = read_pool(Path(job.rir_dir), [Path(path) for path in job.noises])
        self.rules = Rules(job.seed, job.draw_rooms_equally, parse_distribution(job.snr_db, "snr_db"),
                           parse_distribution(job.point_snr_db, "point_snr_db"), job.point_noise_prob,
                           job.max_point_noises)
        self.sounds = Sounds(Path(job.rir_dir), self.pool)


@lru_cache(maxsize=1)
def _session(job: Job) -> _Session:
    return _Session(job)


def _say_what_is_missing(session: _Session) -> None:
    for noises, snr, kind in ((session.pool.ambient, session.rules.ambient_snr, "ambient"),
                              (session.pool.point, session.rules.point_snr, "point")):
        if snr and not noises:
            logger.info("%s: no %s noises given: none are added", session.job.rir_dir, kind)


def _make_recording(job: Job, name: str, utterances: list[Planned]) -> dict:
    """Augment the utterances of one recording; write its audio and, for `_assemble`, their rows."""
    session, work = _session(job), Path(job.work)
    rows, files, pieces, position = [], [], [], 0
    for planned in utterances:
        mixture, row = augment_utterance(session, planned)
        pcm = np.rint(mixture.samples * 32768).astype(np.int16)
        row.update(recording=name, start=position)
        if job.packing == "utterance":
            row.update(recording=planned.id, start=0)
            files.append(write_recording(work, row["speaker"], planned.id, [pcm]))
        else:
            gap = -len(pcm) % GRID_SAMPLES
            pieces += [pcm, np.zeros(gap, np.int16)]
            position += len(pcm) + gap
        rows.append(row)
    if pieces:
        files.append(write_recording(work, rows[0]["speaker"], name, pieces[:-1]))  # nothing follows the last gap
    write_jsonl(work / _ROWS / f"{file_name(name)}.jsonl", rows)
    return dict(files=files, rows=f"{file_name(name)}.jsonl")


def augment_utterance(session: _Session, planned: Planned) -> tuple[Mixture, dict]:
    """Return one far-field utterance and a row that says everything that was drawn for it."""
    utterance, where = planned.clean, f"{session.job.data_dir}: utterance {planned.clean.id}"
    try:
        clean = read_entry(planned.entry, utterance.start_s, utterance.end_s, pipes=session.job.pipes)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    rir_id, draws = session.rules.draw(planned.id, session.pool)
    rir, shift = session.sounds.rir(rir_id)
    reverberated = convolve(clean, rir, shift, len(clean))
    noises, noise_rows = [], []
    for draw in draws:
        samples, start = session.sounds.noise(draw, len(clean))
        noises.append((samples, draw.snr_db))
        noise_rows.append(dict(id=draw.noise.id, kind=draw.noise.kind, rir=draw.rir_id, start=start,
                               snr_db=round(draw.snr_db, 4)))
    try:
        mixture = mix(clean, reverberated, noises)
    except ValueError as error:
        drawn = ", ".join([f"RIR {rir_id}", *(f"noise {draw.noise.id}" for draw in draws)])
        raise ValueError(f"{where} with {drawn}: {error}") from None
    return mixture, dict(
        id=planned.id, clean=utterance.id, speaker=utterance.speaker, n_samples=len(clean), rir=rir_id,
        room=session.pool.rows[rir_id]["room_id"], shift=shift, noises=noise_rows,
        snr_db=None if mixture.snr_db is None else round(mixture.snr_db, 4),
        gain_db=round(mixture.gain_db, 4), peak_gain_db=round(mixture.peak_gain_db, 4))


def _assemble(job: Job, data: DataDir, out: Path, directory: Path, records: list[dict]) -> None:
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
                        data.text and data.text[row["clean"]], row["rir"],
                        "inf" if row["snr_db"] is None else f"{row['snr_db']:.2f}",
                        data.utt2uniq.get(row["clean"], row["clean"]))

        write_data_dir(directory, recordings, utterances(), spk2gender=data.spk2gender,
                       segmented=job.packing == "recording")
    write_json(directory / SUMMARY_FILE, summary.as_dict(_session(job).pool, len(recordings)))
    read_data_dir(directory)


class Summary:
    """Counts over the utterances of a directory."""

    def __init__(self) -> None:
        self.n_utterances = self.n_samples = self.n_turned_down = 0
        self.rirs, self.snrs, self.noises = Counter(), Counter(), Counter()

    def add(self, row: dict) -> None:
        self.n_utterances += 1
        self.n_samples += row["n_samples"]
        self.n_turned_down += row["peak_gain_db"] < 0
        self.rirs[row["rir"]] += 1
        self.noises.update(noise["kind"] for noise in row["noises"])
        self.snrs["none" if row["snr_db"] is None else str(5 * math.floor(row["snr_db"] / 5))] += 1

    def as_dict(self, pool: Pool, n_recordings: int) -> dict:
        """Return the counts as JSON; `snr_histogram` is by the lower edge of 5 dB bins."""
        return dict(utterances=self.n_utterances, recordings=n_recordings, hours=self.n_samples / FS_HZ / 3600,
                    rirs_used=len(self.rirs), rirs=len(pool.main),
                    rooms_used=len({pool.rows[key]["room_id"] for key in self.rirs}),
                    snr_histogram=dict(self.snrs), noises=dict(self.noises), turned_down=self.n_turned_down)


def _log_summary(out: Path, took_s: float | None) -> None:
    summary = read_json(out / SUMMARY_FILE)
    edges = sorted((key for key in summary["snr_histogram"] if key != "none"), key=int)
    bins = [f"{key}..{int(key) + 5}: {summary['snr_histogram'][key]}" for key in edges]
    if "none" in summary["snr_histogram"]:
        bins.append(f"no noise: {summary['snr_histogram']['none']}")
    rate = f", {summary['hours'] * 3600 / took_s:.0f} times real time" if took_s else ""
    logger.info("%s: %d utterances, %.2f h in %d recordings, %d of %d RIRs%s", out, summary["utterances"],
                summary["hours"], summary["recordings"], summary["rirs_used"], summary["rirs"], rate)
    logger.info("%s: utterances by SNR in dB: %s; %d turned down to keep the peak", out, ", ".join(bins),
                summary["turned_down"])
