"""What is drawn for an utterance: SNR distributions, RIRs, noises.

Every utterance takes the same uniform numbers in the same order whatever it is augmented with, and picks by rank
in sorted lists. So RIR directories with the same ids (simulated, and the same compensated) give the same draws.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from statistics import NormalDist

from roomeq.core.audio import audio_info
from roomeq.core.rng import rng_for
from roomeq.records.rir_dir import NOISES_FILE, read_noises, read_rirs
from roomeq.records.schema import RirRow

_MAX_SNR_DB = 200.0


def parse_distribution(text: str, name: str) -> Callable[[float], float] | None:
    """Return the quantile function of an SNR distribution.

    Parameters
    ----------
    text : str
        ``"uniform LOW HIGH"``, ``"normal MEAN SD"``, ``"list A,B,..."`` (each equally likely), one number, or
        ``"none"``; all in dB.
    name : str
        Name of the option, for the message.

    Returns
    -------
    quantile : callable or None
        Turns a number in [0, 1) into an SNR [dB]. None for ``"none"``.

    Raises
    ------
    ValueError
        The text is none of these, or a number is out of range (at most 200 dB).
    """
    kind, _, rest = str(text).strip().partition(" ")
    try:
        if kind == "none" and not rest:
            return None
        numbers = [float(part) for part in (rest if rest else kind).replace(",", " ").split()]
        if not numbers or not all(abs(number) <= _MAX_SNR_DB for number in numbers):
            raise ValueError
        if kind == "uniform" and len(numbers) == 2 and numbers[0] <= numbers[1]:
            return lambda u: numbers[0] + u * (numbers[1] - numbers[0])
        if kind == "normal" and len(numbers) == 2 and numbers[1] > 0:
            return lambda u: NormalDist(*numbers).inv_cdf(min(max(u, 1e-12), 1 - 1e-12))
        if (kind == "list" and rest) or not rest and len(numbers) == 1:
            return lambda u: numbers[int(u * len(numbers))]
        raise ValueError
    except ValueError:
        raise ValueError(f"{name}={text!r} must be 'uniform LOW HIGH', 'normal MEAN SD', 'list A,B,...', a number "
                         f"or 'none', in dB between -{_MAX_SNR_DB:g} and {_MAX_SNR_DB:g}") from None


@dataclass(frozen=True)
class Noise:
    """A noise recording; `room_id` is None where nobody knows the room."""

    id: str
    path: Path
    room_id: str | None
    kind: str

    @cached_property
    def length(self) -> tuple[int, int]:
        """Samples and sample rate [Hz], from the header."""
        info = audio_info(self.path)
        return info.frames, info.samplerate


@dataclass(frozen=True)
class NoiseDraw:
    """One noise of one utterance; `rir_id` is None for ambient noise."""

    noise: Noise
    rir_id: str | None
    snr_db: float
    offset_u: float


@dataclass(frozen=True)
class Pool:
    """The RIRs and noises that utterances draw from.

    Attributes
    ----------
    rows : dict
        Rows of `rirs.jsonl` by id, noise RIRs included.
    main : list of str
        Ids that speech may be convolved with.
    noise_rirs : dict of list of str
        For each of them, the RIRs that a point noise in the same room may be convolved with; may be empty.
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
    def ambient_by_room(self) -> dict[str, list[Noise]]:
        by_room = defaultdict(list)
        for noise in self.ambient:
            by_room[noise.room_id].append(noise)
        return by_room

    def draw_rir(self, u: float, draw_rooms_equally: bool) -> str:
        """Return an RIR id: uniform over RIRs, or over rooms first."""
        if not draw_rooms_equally:
            return self.main[int(u * len(self.main))]
        position = u * len(self.rooms)
        room = self.rooms[int(position)]
        return room[int((position % 1) * len(room))]


def read_pool(rir_dir: Path, noise_dirs: list[Path]) -> Pool:
    """Read what may be drawn: RIRs, and the noises beside them and elsewhere.

    RIRs that the EQ fit screens out (hand claps, say) are real rooms all the same and stay in.

    Parameters
    ----------
    rir_dir : Path
    noise_dirs : list of Path
        Further directories with `noises.jsonl`.

    Raises
    ------
    ValueError
        There is no RIR for speech, a directory has no list of noises, or two noises share an id.
    """
    rows = {row["id"]: row for row in read_rirs(rir_dir)}
    main = [key for key, row in rows.items() if not row.get("noise_for")]
    if not main:
        raise ValueError(f"{rir_dir}: all {len(rows)} RIRs are noise RIRs: one for speech is needed: "
                         "give another directory")
    noises = _noises([rir_dir, *noise_dirs])
    return Pool(rows, main, _noise_rirs(rows, main), [noise for noise in noises if noise.kind == "ambient"],
                [noise for noise in noises if noise.kind == "point"])


def _noise_rirs(rows: Mapping[str, RirRow], main: list[str]) -> dict[str, list[str]]:
    """Return for each main RIR those of its room with another source: simulated for it, else measured."""
    made_for, in_room = defaultdict(list), defaultdict(list)
    for key, row in rows.items():
        if row.get("noise_for"):
            made_for[row["noise_for"]].append(key)
    for key in main:
        in_room[rows[key]["room_id"]].append(key)
    found = {}
    for key in main:
        if made_for[key]:
            found[key] = made_for[key]
            continue
        row, same_room = rows[key], [other for other in in_room[rows[key]["room_id"]] if other != key]
        elsewhere = [other for other in same_room if _other_source(row, rows[other])]
        same_mic = [other for other in elsewhere if rows[other]["mic_id"] == row["mic_id"]]
        found[key] = same_mic or elsewhere or same_room
    return found


def _other_source(row: RirRow, other: RirRow) -> bool:
    """Tell whether two RIRs of a room have different source positions (ids, where no position is known)."""
    here, there = row.get("source_pos_m"), other.get("source_pos_m")
    return here != there if here and there else row["source_id"] != other["source_id"]


def _noises(directories: list[Path]) -> list[Noise]:
    """Return all noises by id; the same recording may be listed by several directories."""
    by_id: dict[str, Noise] = {}
    for n, directory in enumerate(map(Path, directories)):
        if n and not (directory / NOISES_FILE).is_file():
            raise ValueError(f"{directory}: no noises in it ({NOISES_FILE} is missing): "
                             "make it with 'roomeq read-noises'")
        for row in read_noises(directory):
            noise = Noise(row["id"], directory / row["wav"], row.get("room_id"), row["kind"])
            other = by_id.setdefault(noise.id, noise)
            if other.path.resolve() != noise.path.resolve():
                raise ValueError(f"{noise.path}: noise id {noise.id!r} is also that of {other.path}: "
                                 "ids must be unique: rename one")
    return [by_id[key] for key in sorted(by_id)]


@dataclass(frozen=True)
class Rules:
    """How to draw; see `roomeq.augment.far_field.augment` for the options."""

    seed: int
    draw_rooms_equally: bool
    ambient_snr: Callable[[float], float] | None
    point_snr: Callable[[float], float] | None
    point_noise_prob: float
    max_point_noises: int

    def draw(self, utterance_id: str, pool: Pool) -> tuple[str, list[NoiseDraw]]:
        """Draw an utterance's RIR and its noises (ambient first).

        The uniform numbers of each choice stand at fixed places, so that a choice that one pool does not offer
        (no ambient noise, say) does not shift the others.
        """
        rng = rng_for(self.seed, "augment", utterance_id)
        rir_u, noise_u, snr_u, offset_u = rng.random(4).tolist()
        rir_id = pool.draw_rir(rir_u, self.draw_rooms_equally)
        noises = []
        if self.ambient_snr and pool.ambient:
            choices = pool.ambient_by_room.get(pool.rows[rir_id]["room_id"]) or pool.ambient
            noises.append(NoiseDraw(choices[int(noise_u * len(choices))], None, self.ambient_snr(snr_u), offset_u))
        for _ in range(self.max_point_noises):
            there_u, noise_u, noise_rir_u, snr_u, offset_u = rng.random(5).tolist()
            rirs = pool.noise_rirs[rir_id]
            if there_u < self.point_noise_prob and self.point_snr and pool.point and rirs:
                noises.append(NoiseDraw(pool.point[int(noise_u * len(pool.point))],
                                        rirs[int(noise_rir_u * len(rirs))], self.point_snr(snr_u), offset_u))
        return rir_id, noises


def excerpt_start(u: float, n_noise: int, n_samples: int) -> int:
    """Return where an excerpt starts: uniform over all places, or over the ring where the noise must repeat."""
    return math.floor(u * (n_noise - n_samples + 1 if n_noise >= n_samples else n_noise))

