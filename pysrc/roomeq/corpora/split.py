"""Split measured RIRs into training, development and test sets that share no measurement, or no room."""

import hashlib
import logging
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

from roomeq.core.arrays import FloatArray
from roomeq.core.build import Build
from roomeq.corpora.copies import RirSketches, find_rir_copies, first_copy, sketch_noises, sketch_rirs
from roomeq.records.geometry import is_known, position_key
from roomeq.records.rir_dir import read_noises, read_rirs, relocated, write_noises, write_rirs
from roomeq.records.schema import NoiseRow, RirRow

logger = logging.getLogger(__name__)

SPLITS = ("train", "dev", "test")
N_SHUFFLES = 200
"""Random orders of the rooms, of which the one that fits the proportion best is taken."""

Dealt = dict[str, list[NoiseRow]]
"""Noises by split."""
Copies = list[NoiseRow]
"""Noises that are one recording; mostly a single one."""


def split_rirs(rir_dir: Path, out_prefix: str | Path, *, split_by: str = "rir", same_rooms: Sequence[str] = (),
               sizes: Sequence[int] = (773, 194, 242), seed: int, dev_rirs: Path | None = None,
               test_rirs: Path | None = None) -> dict[str, int]:
    """Split an RIR directory into ``<out_prefix>.train``, ``.dev`` and ``.test``.

    Repeats of one source and microphone position stay together, also where heights are unknown, and so do copies of one
    recording, or the rooms that have them. RIRs beyond the sum of `sizes` are left over; if there are fewer, the
    proportion is kept. Noises are split in the same proportion; copies of a noise stay together.

    Parameters
    ----------
    rir_dir : Path
        RIR directory, usually made by `roomeq.corpora.characterise.characterise`.
    out_prefix : str or Path
        e.g. ``data/rirs.real``.
    split_by : str
        ``"rir"`` (as in the paper: a room may be in all three sets) or ``"room"`` (each room is in one set).
    same_rooms : sequence of str
        Patterns (``*``, ``?``, ``[ ]``): all rooms that a pattern matches count as one room, for instance the states
        of a laboratory, or the rooms of a house that open into each other. The first pattern that matches counts. It
        holds for the rooms of noises too.
    sizes : sequence of int
        Number of RIRs for training, development and test; of noises, only the proportion counts.
    seed : int
    dev_rirs, test_rirs : Path, optional
        RIR directories with which to develop and to test, instead of RIRs of `rir_dir`. Noises of `rir_dir` that belong
        to no room are dealt out to all three sets.

    Returns
    -------
    counts : dict
        Number of RIRs per split.

    Raises
    ------
    ValueError
        There are too few RIRs or rooms for the sets, an option is wrong, a noise cannot be read, or two directories
        share an RIR, a noise or an id.
    """
    rir_dir = Path(rir_dir)
    if split_by not in ("rir", "room"):
        raise ValueError(f"split_by={split_by!r} must be 'rir' or 'room'")
    if len(sizes) != 3 or min(sizes) < 1:
        raise ValueError(f"sizes={tuple(sizes)} must be three positive numbers: training, development, test")
    others = {split: Path(given) for split, given in (("dev", dev_rirs), ("test", test_rirs)) if given is not None}
    size_of = dict(zip(SPLITS, sizes, strict=True))
    for directory in (rir_dir, *others.values()):
        read_rirs(directory)  # refuses another directory before all of it is hashed
    # every output is checked before one of them is written, and recordings are as they were, before they are read
    builds = {split: Build(
        Path(f"{out_prefix}.{split}"), step="split", inputs=[rir_dir, *others.values()], refers=True, options=dict(
            split=split, split_by=split_by, same_rooms=list(same_rooms), sizes=list(sizes), seed=seed,
            others=sorted(others))) for split in SPLITS}
    given = [_Given(split, directory, read_rirs(directory), read_noises(directory))  # as they are in the key
             for split, directory in (("train", rir_dir), *others.items())]
    rows, own = given[0].rows, {other.split: other for other in given[1:]}
    _require_apart(given)
    copies = [(rows[n]["id"], rows[m]["id"]) for n, m in find_rir_copies(given[0].rir_sketches)]
    _log_copies(rir_dir, copies)
    _require_other_noises(given)
    of_rirs = {split: size for split, size in size_of.items() if split not in own}
    group_of = _room_groups(rir_dir, rows, split_by, same_rooms, copies)
    split_of = _by_room(rows, group_of, of_rirs, seed) if split_by == "room" else _by_rir(rows, of_rirs, seed, copies)
    if empty := [split for split in of_rirs if split not in split_of.values()]:
        more = [f"--{other}-rirs" for other in ("dev", "test") if other not in own]
        remedies = ["give more RIRs", *[f"others with {' and '.join(more)}"] * bool(more),
                    *["split by 'rir'"] * (split_by == "room")]
        raise ValueError(f"{rir_dir}: {len(rows)} RIRs of {len(set(group_of.values()))} rooms leave {empty[0]} empty "
                         f"when split by {split_by}: {', or '.join(remedies)}")
    homes = _homes(given[0].noises, rows, split_of, same_rooms)
    noises = _split_noises(_copies(given[0]), homes, size_of, seed, split_by,
                           {split: other.noises for split, other in own.items()})
    stale = [build for build in builds.values() if not build.done]
    for build in stale:
        build.withdraw()  # no set of an earlier split beside those of this one
    counts = {}
    for split, build in builds.items():
        whole = own.get(split) or _Given(split, rir_dir, [row for row in rows if split_of.get(row["id"]) == split], [])
        counts[split] = len(whole.rows)
        if build in stale:
            _write(build, relocated(whole.rows, whole.directory, build.out),
                   [*relocated(whole.noises, whole.directory, build.out),
                    *relocated(noises[split], rir_dir, build.out)])
    _log_table(rows, split_of, noises)
    for split, other in own.items():
        logger.info("%s: %d RIRs of %s", split, counts[split], other.directory)
    return counts


@dataclass(frozen=True)
class _Given:
    """An RIR directory, and the split that its RIRs are for; ``"train"`` is the one whose RIRs are split."""

    split: str
    directory: Path
    rows: list[RirRow]
    noises: list[NoiseRow]

    @cached_property
    def rir_sketches(self) -> RirSketches:
        return sketch_rirs(self.directory, self.rows)

    @cached_property
    def noise_sketches(self) -> FloatArray:
        return sketch_noises(self.directory, self.noises)


def _require_apart(given: Sequence[_Given]) -> None:
    """Refuse directories that share recordings, also as copies, or ids; warn of rooms of the same name."""
    for first, other in combinations(given, 2):
        for m, n in find_rir_copies(other.rir_sketches, first.rir_sketches):
            raise _shared("RIR", first, first.rows[n], other, other.rows[m])
        if ids := {row["id"] for row in first.rows} & {row["id"] for row in other.rows}:
            raise ValueError(f"{other.directory}: RIR {min(ids)} has the id of an RIR of {first.directory}: word error "
                             "rates are sorted by room by these ids, rename one")
        if names := {row["room_id"] for row in first.rows} & {row["room_id"] for row in other.rows}:
            logger.warning("%s and %s both have rooms named %s: word error rates take them for the same rooms; rename "
                           "one if they are not", first.directory, other.directory, ", ".join(sorted(names)))


def _log_copies(rir_dir: Path, pairs: Sequence[tuple[str, str]]) -> None:
    """Say which RIRs of a directory are copies of one recording, given the ids of pairs."""
    joined = _Groups()
    for first, second in pairs:
        joined.join(first, second)
    of_recording: dict[str, list[str]] = defaultdict(list)
    for rir_id in sorted({rir_id for pair in pairs for rir_id in pair}):
        of_recording[joined.root(rir_id)].append(rir_id)
    for rir_ids in of_recording.values():
        logger.info("%s: RIRs %s are one recording and stay together", rir_dir, ", ".join(rir_ids))


def _require_other_noises(given: Sequence[_Given]) -> None:
    """Refuse noises whose id the directory that is split has as well, or of which another directory has a copy."""
    for other in given[1:]:
        if ids := {noise["id"] for noise in given[0].noises} & {noise["id"] for noise in other.noises}:
            raise ValueError(f"{other.directory}: noise {min(ids)} has the id of a noise of {given[0].directory}, and "
                             "may come to the same set: rename one")
    for first, other in combinations(given, 2):
        for noise, sketch in zip(other.noises, other.noise_sketches, strict=True):
            if (n := first_copy(sketch, first.noise_sketches)) is not None:
                raise _shared("noise", first, first.noises[n], other, noise)


def _shared(kind: str, first: _Given, row: RirRow | NoiseRow, other: _Given, other_row: RirRow | NoiseRow
            ) -> ValueError:
    return ValueError(f"{other.directory}: {kind} {other_row['id']} is the recording of {kind} {row['id']} of "
                      f"{first.directory}: give recordings for {other.split} that {first.split} does not have")


def _room_groups(rir_dir: Path, rows: Sequence[RirRow], split_by: str, same_rooms: Sequence[str],
                 copies: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Return the group of each room: the pattern that it shares with other rooms, or its own id.

    Groups that have copies of one recording, given as pairs of ids of RIRs, are one.
    """
    if same_rooms and split_by != "room":
        raise ValueError(f"same_rooms={','.join(same_rooms)} keeps rooms together that split_by={split_by!r} "
                         "splits: split by 'room'")
    rooms = sorted({row["room_id"] for row in rows})
    group_of = {room: _group(room, same_rooms) for room in rooms}
    for pattern in same_rooms:
        if pattern not in group_of.values():
            raise ValueError(f"{rir_dir}: same_rooms: {pattern!r} matches no room that is not matched before: they are "
                             f"{', '.join(rooms)}")
    room_of = {row["id"]: row["room_id"] for row in rows}
    joined = _Groups()
    for first, second in copies:
        joined.join(group_of[room_of[first]], group_of[room_of[second]])
    return {room: joined.root(group) for room, group in group_of.items()}


def _group(room: str, same_rooms: Sequence[str]) -> str:
    return next((pattern for pattern in same_rooms if fnmatchcase(room, pattern)), room)


def _random_rank(seed: int, name: str) -> str:
    """Return a key that sorts names in a random order, each independently of the others."""
    return hashlib.sha256(repr((int(seed), "split", name)).encode()).hexdigest()


def _shares(sizes: Sequence[int], n: int) -> list[int]:
    """Return how many of n RIRs each split gets: the sizes if n suffices, else their proportion, at least 1 each."""
    if n >= sum(sizes):
        return list(sizes)
    exact = [n * size / sum(sizes) for size in sizes]
    shares = [max(1, int(part)) for part in exact]
    while sum(shares) != n and n >= len(sizes):
        step = 1 if sum(shares) < n else -1
        missing = [step * (part - share) for part, share in zip(exact, shares, strict=True)]
        candidates = [k for k in range(len(shares)) if step > 0 or shares[k] > 1]
        shares[max(candidates, key=lambda k: missing[k])] += step
    return shares


def _folder_and_name(row: RirRow) -> tuple[str, str]:
    """Return the folder of a recording, and its name, both without the channel, which either may state."""
    path = Path(row.get("recording") or row["wav"]).with_suffix("")
    folder = Path(*(part for part in path.parent.parts if not re.fullmatch(r"(?i:ch)\d+", part)))
    return str(folder), re.sub(r"(^|[._-])((?i:ch)\d+(_e\d+)?|[LR])$|[._-]e\d+$", "", path.name)


def _measurement_keys(rows: Sequence[RirRow]) -> dict[str, list[str]]:
    """Return by id what recordings of one measurement share: the file without its channel, positions, what is known.

    Where positions are not wholly known, files of one name in different folders of a room count as channels too. If
    there are more folders than names and x or y is not known, a folder is a measurement; or the one around it, if
    folders share their name, as those of channels do.
    """
    known_of = {row["id"]: repr((row["room_id"], row["source_id"], row.get("source_pos_m"), row.get("mic_pos_m")))
                for row in rows}
    folders, names = defaultdict(set), defaultdict(set)
    for row in rows:
        folder, name = _folder_and_name(row)
        folders[known_of[row["id"]]].add(folder)
        names[known_of[row["id"]]].add(name)
    shared = {known for known, paths in folders.items() if len({Path(path).name for path in paths}) < len(paths)}
    keys_of = {}
    for row in rows:
        (folder, name), known, position = _folder_and_name(row), known_of[row["id"]], position_key(row)
        keys = [repr((row["room_id"], folder, name))]
        if position is not None:
            keys.append(position)
        if position is None or not is_known(row.get("source_pos_m")) or not is_known(row.get("mic_pos_m")):
            if position is None and len(folders[known]) > len(names[known]):
                name = str(Path(folder).parent) if known in shared else folder
            keys.append(repr((known, name)))
        keys_of[row["id"]] = keys
    return keys_of


class _Groups:
    """Groups of names that share something, directly or through other names."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}

    def root(self, name: str) -> str:
        """Return the name that stands for a name's group."""
        while self._parent.setdefault(name, name) != name:
            name = self._parent[name]
        return name

    def join(self, first: str, second: str) -> None:
        """Make the groups of two names one, for which the name of the first stands."""
        self._parent[self.root(second)] = self.root(first)


def _measurements(rows: Sequence[RirRow], copies: Sequence[tuple[str, str]]) -> list[list[str]]:
    """Return the ids of each measurement: of rows that share a key or a recording, directly or through other rows."""
    joined = _Groups()
    keys_of = _measurement_keys(rows)
    for first, *others in keys_of.values():
        for other in others:
            joined.join(first, other)
    for one, other in copies:
        joined.join(keys_of[one][0], keys_of[other][0])
    groups: dict[str, list[str]] = defaultdict(list)
    for rir_id, keys in keys_of.items():
        groups[joined.root(keys[0])].append(rir_id)
    return list(groups.values())


def _by_rir(rows: Sequence[RirRow], size_of: Mapping[str, int], seed: int,
            copies: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Return the split of each id; the RIRs of one measurement go to the first split with space for all of them."""
    free = dict(zip(size_of, _shares(list(size_of.values()), len(rows)), strict=True))
    split_of: dict[str, str] = {}
    for ids in sorted(_measurements(rows, copies), key=lambda ids: _random_rank(seed, ids[0])):
        split = next((name for name in size_of if free[name] >= len(ids)), None)
        if split is None and len(rows) <= sum(size_of.values()):
            split = max(size_of, key=lambda name: free[name])
        if split is not None:
            free[split] -= len(ids)
            split_of.update(dict.fromkeys(ids, split))
    return split_of


def _by_room(rows: Sequence[RirRow], group_of: Mapping[str, str], size_of: Mapping[str, int],
             seed: int) -> dict[str, str]:
    """Return the split of each id, groups of rooms kept together: the best of many random orders."""
    import numpy as np

    rooms: dict[str, list[str]] = defaultdict(list)
    for row in rows:
        rooms[group_of[row["room_id"]]].append(row["id"])
    splits, shares = list(size_of), np.array(_shares(list(size_of.values()), len(rows)), dtype=float)
    best: dict[str, str] = {}
    best_error = np.inf
    for attempt in range(N_SHUFFLES):
        order = sorted(rooms, key=lambda room: _random_rank(seed, f"{attempt} {room}"))
        filled = np.zeros(len(splits))
        split_of: dict[str, str] = {}
        for n, room in enumerate(order):
            # one of the first rooms each, so that no split is empty
            k = n if n < len(splits) else int(np.argmax((shares - filled) / shares))
            filled[k] += len(rooms[room])
            split_of.update(dict.fromkeys(rooms[room], splits[k]))
        error = float(np.sum((filled - shares) ** 2 / shares))
        if error < best_error:
            best, best_error = split_of, error
    return best


def _homes(noises: Sequence[NoiseRow], rows: Sequence[RirRow], split_of: Mapping[str, str],
           same_rooms: Sequence[str]) -> dict[str, set[str]]:
    """Return the splits of the RIRs of each noise's room; a room without RIRs may be in a group that has some."""
    splits_of: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        if row["id"] in split_of:
            splits_of[_group(row["room_id"], same_rooms)].add(split_of[row["id"]])
    return {noise["id"]: splits_of.get(_group(room, same_rooms), set())
            for noise in noises if (room := noise.get("room_id"))}


def _copies(given: _Given) -> list[Copies]:
    """Return the noises, those together that are copies of each other."""
    groups: dict[int | None, Copies] = defaultdict(list)
    for noise, sketch in zip(given.noises, given.noise_sketches, strict=True):
        groups[first_copy(sketch, given.noise_sketches)].append(noise)
    for copies in groups.values():
        if len(copies) > 1:
            logger.info("%s: noises %s are one recording and stay together", given.directory,
                        ", ".join(noise["id"] for noise in copies))
    return list(groups.values())


def _split_noises(noises: Sequence[Copies], homes: Mapping[str, set[str]], size_of: Mapping[str, int], seed: int,
                  split_by: str, own: Dealt) -> Dealt:
    """Return the noises of each split; each kind is dealt out by itself, so that every split gets some of it.

    `homes` are the splits of the RIRs of each noise's room. Splits that have noises of that kind of their `own` may get
    none.
    """
    dealt: Dealt = {split: [] for split in size_of}
    for kind in sorted({copies[0]["kind"] for copies in noises}):
        of_kind = [copies for copies in noises if copies[0]["kind"] == kind]
        served = {split for split, noises in own.items() if any(noise["kind"] == kind for noise in noises)}
        for split, share in _deal(of_kind, kind, homes, size_of, seed, split_by, served).items():
            dealt[split] += [noise for copies in share for noise in copies]
    return dealt


def _deal(noises: Sequence[Copies], kind: str, homes: Mapping[str, set[str]], size_of: Mapping[str, int], seed: int,
          split_by: str, served: set[str]) -> dict[str, list[Copies]]:
    """Deal out noises of one kind: to the split of their room's RIRs, in proportion among several such splits."""
    dealt: dict[str, list[Copies]] = {split: [] for split in size_of}
    undecided: list[tuple[Copies, set[str]]] = []
    for copies in sorted(noises, key=lambda copies: (str(copies[0].get("room_id")),
                                                     _random_rank(seed, copies[0]["id"]))):
        splits = {split for noise in copies for split in homes.get(noise["id"], ())}
        if split_by == "room" and len(splits) == 1:
            dealt[next(iter(splits))].append(copies)
        else:
            undecided.append((copies, splits or set(size_of)))
    wanted = {split: size / sum(size_of.values()) * len(noises) for split, size in size_of.items()}
    for copies, splits in undecided:
        # in relation to the wanted number, so that small splits are not served last
        missing = {split: (wanted[split] - len(dealt[split])) / wanted[split] for split in size_of if split in splits}
        dealt[max(missing, key=missing.__getitem__)].append(copies)
    return _fill_empty(dealt, kind, split_by, served)


def _fill_empty(dealt: dict[str, list[Copies]], kind: str, split_by: str,
                served: set[str]) -> dict[str, list[Copies]]:
    """Give every split that is not served noises: one of the split with most, or all if that has none to spare."""
    for split in dealt:
        richest = max(dealt, key=lambda name: len(dealt[name]))
        if dealt[split] or split in served:
            continue
        if len(dealt[richest]) > 1 and split_by == "rir":
            dealt[split].append(dealt[richest].pop())
        else:
            logger.warning("%s has no %s noises of its own and shares those of %s: add noises", split, kind, richest)
            dealt[split] = list(dealt[richest])
    return dealt


def _write(build: Build, rows: list[dict[str, Any]], noises: list[dict[str, Any]]) -> None:
    def assemble(directory: Path, _: list[Any]) -> None:
        write_rirs(directory, rows, final_directory=build.out)
        write_noises(directory, noises)

    if build.run({}, lambda name, item: None):
        build.finish(assemble)


def _log_table(rows: Sequence[RirRow], split_of: Mapping[str, str], noises: Dealt) -> None:
    """Log how many RIRs of each room went to each split."""
    count = Counter((row["room_id"], split_of.get(row["id"], "left over")) for row in rows)
    columns = [*noises, *(["left over"] if any(split == "left over" for _, split in count) else [])]
    rooms = sorted({row["room_id"] for row in rows})
    width = max(len(name) for name in [*rooms, "noises"])
    lines = [f"{'RIRs per room':{width}s}" + "".join(f"{column:>10s}" for column in columns)]
    lines += [f"{room:{width}s}" + "".join(f"{count[room, column]:10d}" for column in columns) for room in rooms]
    lines.append(f"{'all':{width}s}" + "".join(
        f"{sum(count[room, column] for room in rooms):10d}" for column in columns))
    lines.append(f"{'noises':{width}s}" + "".join(f"{len(noises.get(column, [])):10d}" for column in columns))
    logger.info("%s", "\n".join(lines))
