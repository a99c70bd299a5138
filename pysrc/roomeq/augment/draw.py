"""Draw the RIR, the noises and the SNRs of each utterance.

Every utterance uses the same uniform numbers in the same order whatever it is augmented with, and chooses by rank in
sorted lists. RIR directories with the same ids (simulated ones and their compensated versions) therefore give the same
draws.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from roomeq.augment.distribution import Quantile
from roomeq.core.arrays import Array
from roomeq.core.audio import audio_info
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.corpora.suspicious import without_suspicious
from roomeq.kaldi.wavscp import AudioLength
from roomeq.records.rir_dir import NOISES_FILE, read_noises, read_rirs
from roomeq.records.schema import RirRow


@dataclass(frozen=True)
class Noise:
    """A noise recording: a file, or `samples` in memory at `fs_hz`.

    `room_id` is None if the room is unknown, `kind` is ``"ambient"`` or ``"point"``.
    """

    id: str
    path: Path
    room_id: str | None
    kind: str
    samples: Array | None = None
    fs_hz: int = FS_HZ

    @cached_property
    def length(self) -> AudioLength:
        """Length of the samples, or of the file, from its header."""
        if self.samples is not None:
            return AudioLength(len(self.samples), self.fs_hz)
        info = audio_info(self.path)
        return AudioLength(info.frames, info.samplerate)


@dataclass(frozen=True)
class NoiseDraw:
    """One noise of one utterance.

    Attributes
    ----------
    rir_id : str or None
        RIR to convolve the noise with; None for ambient noise.
    offset_u : float
        Where the excerpt starts, as a uniform number in [0, 1).
    """

    noise: Noise
    rir_id: str | None
    snr_db: float
    offset_u: float


@dataclass(frozen=True)
class Pool:
    """RIRs and noises to draw from.

    Attributes
    ----------
    rows : dict
        Rows of `rirs.jsonl` by id, noise RIRs included.
    main : list of str
        Ids of the RIRs for speech.
    noise_rirs : dict of list of str
        For each of them, the RIRs for a point noise in the same room; may be empty.
    ambient, point : list of Noise
        Sorted by id.
    """

    rows: Mapping[str, RirRow]
    main: list[str]
    noise_rirs: dict[str, list[str]]
    ambient: list[Noise] = field(default_factory=list)
    point: list[Noise] = field(default_factory=list)

    @cached_property
    def rooms(self) -> list[list[str]]:
        """Main RIRs by room, in the order of the room ids."""
        rooms = defaultdict(list)
        for rir_id in self.main:
            rooms[self.rows[rir_id]["room_id"]].append(rir_id)
        return [rooms[room] for room in sorted(rooms)]

    @cached_property
    def ambient_by_room(self) -> dict[str | None, list[Noise]]:
        """Ambient noises by room."""
        by_room = defaultdict(list)
        for noise in self.ambient:
            by_room[noise.room_id].append(noise)
        return by_room

    def draw_rir(self, u: float, draw_rooms_equally: bool) -> str:
        """Return the id of an RIR: uniform over RIRs, or uniform over rooms and then over the RIRs of the room."""
        if not draw_rooms_equally:
            return self.main[int(u * len(self.main))]
        position = u * len(self.rooms)
        room = self.rooms[int(position)]
        return room[int((position % 1) * len(room))]


def read_pool(rir_dir: Path, noise_dirs: list[Path]) -> Pool:
    """Read the RIRs of a directory, its noises, and those of further directories with `noises.jsonl`.

    RIRs that the EQ fit screens out (hand claps, for example) are kept: their rooms are real. Recordings
    that are no RIR are left out (`roomeq.corpora.suspicious`).

    Raises
    ------
    ValueError
        There is no RIR for speech, a directory has no list of noises, or two noises share an id.
    """
    rows = {row["id"]: row for row in without_suspicious(rir_dir, read_rirs(rir_dir))}
    main = [key for key, row in rows.items() if not row.get("noise_for")]
    if not main:
        raise ValueError(f"{rir_dir}: all {len(rows)} RIRs are noise RIRs: one for speech is needed: "
                         "give another directory")
    noises = _noises([rir_dir, *noise_dirs])
    return Pool(rows, main, _noise_rirs(rows, main), [noise for noise in noises if noise.kind == "ambient"],
                [noise for noise in noises if noise.kind == "point"])


def _noise_rirs(rows: Mapping[str, RirRow], main: list[str]) -> dict[str, list[str]]:
    """Return for each main RIR those of its noise sources: simulated for it, else others of the room.

    Among the others, those with another source position come first, and of these those with the same microphone.
    """
    simulated, of_room = defaultdict(list), defaultdict(list)
    for rir_id, row in rows.items():
        if noise_for := row.get("noise_for"):
            simulated[noise_for].append(rir_id)
    for rir_id in main:
        of_room[rows[rir_id]["room_id"]].append(rir_id)
    noise_rirs = {}
    for rir_id in main:
        if simulated[rir_id]:
            noise_rirs[rir_id] = simulated[rir_id]
            continue
        row = rows[rir_id]
        same_room = [candidate for candidate in of_room[row["room_id"]] if candidate != rir_id]
        elsewhere = [candidate for candidate in same_room if _sources_differ(row, rows[candidate])]
        same_mic = [candidate for candidate in elsewhere if rows[candidate]["mic_id"] == row["mic_id"]]
        noise_rirs[rir_id] = same_mic or elsewhere or same_room
    return noise_rirs


def _sources_differ(first: RirRow, second: RirRow) -> bool:
    """Return whether two RIRs of a room have different source positions; ids decide if a position is unknown."""
    first_pos_m, second_pos_m = first.get("source_pos_m"), second.get("source_pos_m")
    if first_pos_m and second_pos_m:
        return first_pos_m != second_pos_m
    return first["source_id"] != second["source_id"]


def _noises(directories: list[Path]) -> list[Noise]:
    """Return all noises, sorted by id; several directories may list the same recording."""
    by_id: dict[str, Noise] = {}
    for n, directory in enumerate(map(Path, directories)):
        if n and not (directory / NOISES_FILE).is_file():
            raise ValueError(f"{directory}: no noises in it ({NOISES_FILE} is missing): "
                             "make it with 'roomeq read-noises'")
        for row in read_noises(directory):
            noise = Noise(row["id"], directory / row["wav"], row.get("room_id"), row["kind"])
            known = by_id.setdefault(noise.id, noise)
            if known.path.resolve() != noise.path.resolve():
                raise ValueError(f"{noise.path}: noise id {noise.id!r} is also that of {known.path}: "
                                 "ids must be unique: rename one")
    return [by_id[noise_id] for noise_id in sorted(by_id)]


@dataclass(frozen=True)
class DrawRules:
    """Options of `roomeq.augment.augment` that draws depend on."""

    seed: int
    draw_rooms_equally: bool
    ambient_snr: Quantile | None
    point_snr: Quantile | None
    point_noise_prob: float
    max_point_noises: int

    def draw(self, utterance_id: str, pool: Pool) -> tuple[str, list[NoiseDraw]]:
        """Draw the RIR of an utterance and its noises, ambient noise first.

        Each choice has its own uniform numbers: a choice that a pool does not offer (no ambient noise, for example)
        does not shift the others.
        """
        rng = rng_for(self.seed, "augment", utterance_id)
        rir_u, noise_u, snr_u, offset_u = rng.random(4).tolist()
        rir_id = pool.draw_rir(rir_u, self.draw_rooms_equally)
        noises = []
        if self.ambient_snr and pool.ambient:
            choices = pool.ambient_by_room.get(pool.rows[rir_id]["room_id"]) or pool.ambient
            noises.append(NoiseDraw(choices[int(noise_u * len(choices))], None, self.ambient_snr(snr_u), offset_u))
        for _ in range(self.max_point_noises):
            present_u, noise_u, noise_rir_u, snr_u, offset_u = rng.random(5).tolist()
            rirs = pool.noise_rirs[rir_id]
            if present_u < self.point_noise_prob and self.point_snr and pool.point and rirs:
                noises.append(NoiseDraw(pool.point[int(noise_u * len(pool.point))],
                                        rirs[int(noise_rir_u * len(rirs))], self.point_snr(snr_u), offset_u))
        return rir_id, noises


def excerpt_start(u: float, n_noise: int, n_samples: int) -> int:
    """Return where an excerpt starts: uniform over all positions, or over the whole noise if it has to repeat."""
    return math.floor(u * (n_noise - n_samples + 1 if n_noise >= n_samples else n_noise))

