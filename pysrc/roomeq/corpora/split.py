"""Splitting measured RIRs into training, development and test sets that share nothing."""

import hashlib
import logging
import re
from collections import Counter, defaultdict
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from roomeq.core.build import Build
from roomeq.records.geometry import position_key
from roomeq.records.rir_dir import read_noises, read_rirs, relocated, write_noises, write_rirs

logger = logging.getLogger(__name__)

SPLITS = ("train", "dev", "test")
N_SHUFFLES = 200  # orders of the rooms that are tried for the best proportion


def split_rirs(rir_dir, out_prefix, *, split_by="rir", same_rooms=(), sizes=(773, 194, 242), seed):
    """Split an RIR directory into ``<out_prefix>.train``, ``.dev`` and ``.test``.

    Repeats of one source and microphone position stay together. Where more RIRs are given than `sizes` ask
    for, the rest is left over; where there are fewer, the proportion is kept. Noises are split alike.

    Parameters
    ----------
    rir_dir : Path
        RIR directory, as a rule what `roomeq.corpora.characterise.characterise` made.
    out_prefix : str or Path
        e.g. ``data/rirs.real``.
    split_by : str
        ``"rir"`` (the paper: rooms are in all three) or ``"room"`` (no room is in two).
    same_rooms : sequence of str
        Patterns (``*``, ``?``, ``[ ]``): the rooms that one matches count as one room, such as the states of a
        laboratory or the rooms of a house that open into each other. Where two match, the first.
    sizes : tuple of int
        RIRs for training, development and test.
    seed : int

    Returns
    -------
    dict
        Number of RIRs per split.

    Raises
    ------
    ValueError
        There are too few RIRs or rooms for three sets, or an option is wrong.
    """
    rir_dir = Path(rir_dir)
    if split_by not in ("rir", "room"):
        raise ValueError(f"split_by={split_by!r} must be 'rir' or 'room'")
    if len(sizes) != 3 or min(sizes) < 1:
        raise ValueError(f"sizes={tuple(sizes)} must be three positive numbers: training, development, test")
    rows = read_rirs(rir_dir)
    place_of = _places(rir_dir, rows, split_by, same_rooms)
    split_of = _by_room(rows, place_of, sizes, seed) if split_by == "room" else _by_rir(rows, sizes, seed)
    counts = Counter(split_of.values())
    for split in SPLITS:
        if not counts[split]:
            raise ValueError(f"{rir_dir}: {len(rows)} RIRs of {len(set(place_of.values()))} rooms leave {split} empty "
                             f"when split by {split_by}: give more RIRs, or split by 'rir'")
    noises = _split_noises(read_noises(rir_dir), rows, split_of, sizes, seed, split_by)
    # all places are looked at before anything goes to one of them
    builds = {split: Build(Path(f"{out_prefix}.{split}"), step="split", inputs=[rir_dir], refers=True, options=dict(
        split=split, split_by=split_by, same_rooms=list(same_rooms), sizes=list(sizes), seed=seed)) for split in SPLITS}
    for split, build in builds.items():
        _write(build, rir_dir, [row for row in rows if split_of.get(row["id"]) == split], noises[split])
    _log_table(rows, split_of, noises)
    return {split: counts[split] for split in SPLITS}


def _places(rir_dir, rows, split_by, same_rooms):
    """What each room counts as: its own name, or the pattern that it shares with others."""
    if same_rooms and split_by != "room":
        raise ValueError(f"same_rooms={','.join(same_rooms)} keeps rooms whole that split_by={split_by!r} parts: "
                         "split by 'room'")
    rooms = sorted({row["room_id"] for row in rows})
    place_of = {room: next((one for one in same_rooms if fnmatchcase(room, one)), room) for room in rooms}
    for pattern in same_rooms:
        if pattern not in place_of.values():
            raise ValueError(f"{rir_dir}: same_rooms: {pattern!r} matches no room that is not matched before: they are "
                             f"{', '.join(rooms)}")
    return place_of


def _hashed(seed, name):
    """Stable place of a name in a random order."""
    return hashlib.sha256(repr((int(seed), "split", name)).encode()).hexdigest()


def _shares(sizes, n):
    """How many of n things each split gets: the sizes where n suffices, else their proportion, none empty."""
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


def _measurement(row):
    """What recordings of one measurement have in common: positions, or where those are unknown the file but for its
    channel."""
    place = position_key(row)
    if place is None:
        stem = re.sub(r"[._-](ch\d+|[LR])$", "", Path(row["wav"]).stem)
        place = (row["room_id"], row["source_id"], row.get("source_pos_m"), row.get("mic_pos_m"), stem)
    return repr(place)


def _by_rir(rows, sizes, seed):
    """Split of each id; groups of one measurement go to the first set that has room for all of them."""
    groups = defaultdict(list)
    for row in rows:
        groups[_measurement(row)].append(row["id"])
    free = dict(zip(SPLITS, _shares(sizes, len(rows)), strict=True))
    split_of = {}
    for ids in sorted(groups.values(), key=lambda ids: _hashed(seed, ids[0])):
        split = next((name for name in SPLITS if free[name] >= len(ids)), None)
        if split is None and len(rows) <= sum(sizes):
            split = max(SPLITS, key=lambda name: free[name])
        if split is not None:
            free[split] -= len(ids)
            split_of.update(dict.fromkeys(ids, split))
    return split_of


def _by_room(rows, place_of, sizes, seed):
    """Split of each id, places kept whole: of many random orders the one that comes closest to the proportion."""
    rooms = defaultdict(list)
    for row in rows:
        rooms[place_of[row["room_id"]]].append(row["id"])
    shares = np.array(_shares(sizes, len(rows)), dtype=float)
    best, best_error = {}, np.inf
    for attempt in range(N_SHUFFLES):
        order = sorted(rooms, key=lambda room: _hashed(seed, f"{attempt} {room}"))
        filled, split_of = np.zeros(3), {}
        for n, room in enumerate(order):
            # the first three rooms make sure that no set is empty
            k = n if n < len(SPLITS) else int(np.argmax((shares - filled) / shares))
            filled[k] += len(rooms[room])
            split_of.update(dict.fromkeys(rooms[room], SPLITS[k]))
        error = float(np.sum((filled - shares) ** 2 / shares))
        if error < best_error:
            best, best_error = split_of, error
    return best


def _split_noises(noises, rows, split_of, sizes, seed, split_by):
    """Noises of each split, each kind by itself, so that no set lacks what another has."""
    dealt = {split: [] for split in SPLITS}
    for kind in sorted({noise["kind"] for noise in noises}):
        alike = [noise for noise in noises if noise["kind"] == kind]
        for split, share in _deal(alike, kind, rows, split_of, sizes, seed, split_by).items():
            dealt[split] += share
    return dealt


def _deal(noises, kind, rows, split_of, sizes, seed, split_by):
    """Noises of one kind: a room's go where its RIRs go; where all sets hold the room, they are dealt out."""
    dealt = {split: [] for split in SPLITS}
    home = defaultdict(set)
    for row in rows:
        if row["id"] in split_of:
            home[row["room_id"]].add(split_of[row["id"]])
    free_to_go = []
    for noise in sorted(noises, key=lambda noise: (str(noise.get("room_id")), _hashed(seed, noise["id"]))):
        where = home.get(noise.get("room_id"), set())
        if split_by == "room" and len(where) == 1:
            dealt[next(iter(where))].append(noise)
        else:
            free_to_go.append((noise, where or set(SPLITS)))
    wanted = np.array(sizes, dtype=float) / sum(sizes) * len(noises)
    for noise, where in free_to_go:
        lack = {split: wanted[k] - len(dealt[split]) for k, split in enumerate(SPLITS) if split in where}
        # relative to what it shall have, so that small sets are not served last
        dealt[max(lack, key=lambda split: lack[split] / wanted[SPLITS.index(split)])].append(noise)
    return _none_without(dealt, kind, split_by)


def _none_without(dealt, kind, split_by):
    """Give every split noises: move one from the set that has most; only where none is to spare, share."""
    for split in SPLITS:
        richest = max(SPLITS, key=lambda name: len(dealt[name]))
        if dealt[split]:
            continue
        if len(dealt[richest]) > 1 and split_by == "rir":
            dealt[split].append(dealt[richest].pop())
        else:
            logger.warning("%s has no noises of its own (%s) and shares those of %s: give more", split, kind, richest)
            dealt[split] = list(dealt[richest])
    return dealt


def _write(build, rir_dir, rows, noises):
    def assemble(directory, _):
        write_rirs(directory, relocated(rows, rir_dir, build.out), final_directory=build.out)
        write_noises(directory, relocated(noises, rir_dir, build.out))

    if not build.done and build.run({}, lambda name, item: None):
        build.finish(assemble)


def _log_table(rows, split_of, noises):
    """Print how many RIRs of each room went where."""
    count = Counter((row["room_id"], split_of.get(row["id"], "left over")) for row in rows)
    columns = [*SPLITS, *(["left over"] if any(split == "left over" for _, split in count) else [])]
    rooms = sorted({row["room_id"] for row in rows})
    width = max(len(name) for name in [*rooms, "noises"])
    lines = [f"{'RIRs per room':{width}s}" + "".join(f"{column:>10s}" for column in columns)]
    lines += [f"{room:{width}s}" + "".join(f"{count[room, column]:10d}" for column in columns) for room in rooms]
    lines.append(f"{'all':{width}s}" + "".join(
        f"{sum(count[room, column] for room in rooms):10d}" for column in columns))
    lines.append(f"{'noises':{width}s}" + "".join(f"{len(noises.get(column, [])):10d}" for column in columns))
    logger.info("%s", "\n".join(lines))
