"""Far-field data directories from clean ones: reverberate, add noise, keep the duration of every utterance.

Utterances are planned into recordings (`roomeq.augment.pack`), and each recording is one item of a `Build`. What is
drawn for an utterance is in `roomeq.augment.draw`, the signal processing in `roomeq.augment.mix`.
"""

import logging
import time
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roomeq.augment.audio_cache import AudioCache
from roomeq.augment.distribution import parse_distribution
from roomeq.augment.draw import DrawRules, read_pool
from roomeq.augment.mix import MixedUtterance, convolve, mix, spectra_of, without_rumble
from roomeq.augment.pack import PlannedUtterance, RecordingFile, file_name, plan_recordings
from roomeq.augment.step import ROWS_FOLDER, SUMMARY_FILE, AugmentConfig
from roomeq.augment.summary import Summary, log_summary
from roomeq.core.arrays import Array
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import errors_naming, read_jsonl, to_json, write_json, write_jsonl
from roomeq.kaldi.datadir import DataDir, Utterance, read_data_dir
from roomeq.kaldi.validate import MAX_DURATION_ERROR_S
from roomeq.kaldi.wavscp import flac_entry, read_entry
from roomeq.kaldi.write import OutUtterance, write_data_dir
from roomeq.records.rir_dir import n_channels, require_16_khz

logger = logging.getLogger(__name__)

ROWS_FILE = "augment.jsonl"
_MARK = 8  # letters of the key of a build in the ids of its recordings


def make(build: Build, config: AugmentConfig, part: str | None, nj: int) -> bool:
    """Make the directory of a build; return False where only a part was to be done.

    Raises
    ------
    ValueError
        See `roomeq.augment.step.augment`.
    """
    flac_entry(str(build.out))  # refuse a path that wav.scp cannot name before hours of work
    from_scratch, start_s = not build.work.exists(), time.monotonic()
    data = read_data_dir(Path(config.data_dir), pipes=config.pipes)
    augmenter = _augmenter(config, build.work)
    _log_missing_noises(augmenter)
    if any(n_channels(row) > 1 for row in augmenter.pool.rows.values()):
        logger.info("%s: of arrays of microphones, the first one is used", config.rir_dir)
    plan = plan_recordings(data, config.copies, pipes=config.pipes)
    if not build.run(plan, partial(_make_recording, config, build.work, build.key[:_MARK]), part=part, nj=nj):
        return False
    made_here = build.finish(partial(_assemble, config, build.work, data, build.out))
    log_summary(build.out, time.monotonic() - start_s if from_scratch and made_here else None)
    return True


class _Augmenter:
    """State of one process. None of it grows with the number of utterances."""

    def __init__(self, config: AugmentConfig) -> None:
        self.config = config
        self.pool = read_pool(Path(config.rir_dir), [Path(path) for path in config.noises])
        require_16_khz(Path(config.rir_dir), self.pool.rows.values())
        self.rules = DrawRules(config.seed, config.draw_rooms_equally, parse_distribution(config.snr_db, "snr_db"),
                               parse_distribution(config.point_snr_db, "point_snr_db"), config.point_noise_prob,
                               config.max_point_noises)
        self.cache = AudioCache(Path(config.rir_dir), self.pool)
        self._clean: tuple[Utterance, Array, Array] | None = None

    def augment(self, planned: PlannedUtterance) -> tuple[MixedUtterance, dict]:
        """Return one far-field utterance and its row of `augment.jsonl`, which states all draws."""
        utterance, where = planned.clean, f"{self.config.data_dir}: utterance {planned.clean.id}"
        clean, spectra = self._read(planned, where)
        rir_id, draws = self.rules.draw(planned.id, self.pool)
        rir, shift = self.cache.rir(rir_id)
        reverberated = convolve(spectra, rir, shift, len(clean))
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

    def _read(self, planned: PlannedUtterance, where: str) -> tuple[Array, Array]:
        """Return a clean utterance without rumble, and its spectra, which are kept for its next copy."""
        utterance = planned.clean
        if self._clean is None or self._clean[0] != utterance:
            self._clean = None  # an utterance may last for hours: not two at a time
            try:
                clean = without_rumble(
                    read_entry(planned.entry, utterance.start_s, utterance.end_s, pipes=self.config.pipes), FS_HZ)
            except ValueError as error:
                raise ValueError(f"{where}: {error}") from None
            length_s = len(clean) / FS_HZ
            if planned.stated_s is not None and abs(length_s - planned.stated_s) > MAX_DURATION_ERROR_S:
                raise ValueError(f"{where}: {planned.entry.text} lasts {length_s:.3f} s where utt2dur says "
                                 f"{planned.stated_s:.3f} s: prepare the directory again, or put the right audio there")
            self._clean = utterance, clean, spectra_of(clean)
        return self._clean[1:]


@lru_cache(maxsize=1)
def _augmenter(config: AugmentConfig, work: Path) -> _Augmenter:
    """Return the state of this process for one build; `work` changes with the content of the inputs."""
    return _Augmenter(config)


def _log_missing_noises(augmenter: _Augmenter) -> None:
    pool, rules = augmenter.pool, augmenter.rules
    for noises, snr, kind in ((pool.ambient, rules.ambient_snr, "ambient"), (pool.point, rules.point_snr, "point")):
        if snr and not noises:
            logger.info("%s: no %s noises given: none are added", augmenter.config.rir_dir, kind)


def _make_recording(config: AugmentConfig, work: Path, mark: str, name: str, utterances: list[PlannedUtterance]
                    ) -> dict:
    """Augment the utterances of one recording; write its audio below `work`, and their rows for `_assemble`.

    The recording's id ends in `mark`, which no other set has: Kaldi's `combine_data.sh` takes recordings of the same id
    for the same audio.
    """
    augmenter = _augmenter(config, work)
    packed = {name: utterances} if config.packing == "recording" else {planned.id: [planned] for planned in utterances}
    rows, files = [], []
    for file, members in packed.items():
        recording_id = f"{file}-{mark}" if config.packing == "recording" else file
        recording = RecordingFile(members[0].clean.speaker, file)
        for planned in members:
            mixed, row = augmenter.augment(planned)
            samples = np.rint(mixed.samples * 32768).astype(np.int16)
            if not samples.any():
                raise ValueError(f"{config.data_dir}: utterance {planned.clean.id}: peak "
                                 f"{np.abs(mixed.samples).max():.2g} of its far-field speech rounds to 0 in 16 bits: "
                                 "raise the level of its audio, or leave it out of the data directory")
            start = recording.append(samples)
            rows.append(row | dict(recording=recording_id, start=start))
        files.append(recording.save(work) | dict(recording=recording_id))
    write_jsonl(work / ROWS_FOLDER / f"{file_name(name)}.jsonl", rows)
    return dict(files=files, rows=f"{file_name(name)}.jsonl")


def _assemble(config: AugmentConfig, work: Path, data: DataDir, out: Path, directory: Path,
              records: list[dict]) -> None:
    """Write the tables of the whole directory, streaming over the rows of all recordings."""
    recordings = {file["recording"]: (flac_entry(str(out / file["file"])), file["n_samples"])
                  for record in records for file in record["files"]}
    summary = Summary()
    rows_file = directory / ROWS_FILE
    with errors_naming(rows_file), open(rows_file, "w", encoding="utf-8", newline="\n") as stream:
        def utterances() -> Iterator[OutUtterance]:
            for record in records:
                for row in read_jsonl(directory / ROWS_FOLDER / record["rows"]):
                    stream.write(to_json(row) + "\n")
                    summary.add(row)
                    yield OutUtterance(
                        row["id"], row["speaker"], row["recording"], row["start"], row["n_samples"],
                        text=data.text[row["clean"]] if data.text else None, rir=row["rir"],
                        snr_db="inf" if row["snr_db"] is None else f"{row['snr_db']:.2f}",
                        uniq=data.utt2uniq.get(row["clean"], row["clean"]), lang=data.utt2lang.get(row["clean"]))

        write_data_dir(directory, recordings, utterances(), spk2gender=data.spk2gender,
                       segmented=config.packing == "recording")
    write_json(directory / SUMMARY_FILE, summary.as_dict(_augmenter(config, work).pool, len(recordings)))
    read_data_dir(directory)
