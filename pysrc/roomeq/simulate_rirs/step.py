"""The step that simulates an RIR directory. What it simulates with is imported where there is work to do."""

import logging
import re
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ, is_number, require_fs
from roomeq.draw_rooms.room_types import read_room_types
from roomeq.records.rir_dir import decay_range_s, mesh_files, read_rirs, warn_of_unused_keys
from roomeq.records.schema import RirRow
from roomeq.sim.defaults import DEFAULT_TABLE, ISM_ORDER, NUM_RAYS, ORDER, TARGET_RANGE_S
from roomeq.sim.published import published_file
from roomeq.simulate_rirs.options import RenderOptions, check_options

logger = logging.getLogger(__name__)

MAX_ROOMS = 10 ** 6
"""Largest number of rooms of one directory."""


def simulate(measured_dir: Path | str | None, out: Path | str, *, rooms: int | str | None = None,
             room_types: Path | str | None = None, t60_range_s: tuple[float, float] | str | None = None,
             num_rays: int = NUM_RAYS, ism_order: int = ISM_ORDER, order: int = ORDER, noise_rirs: int = 1,
             materials: Path | str | None = None, model: Path | str | None = None, draw_devices: bool = False,
             diffraction: bool = True, fs_hz: int = FS_HZ, seed: int = 0, part: str | None = None, nj: int = 1) -> None:
    """Simulate one RIR per measured RIR, in its room and from its source to its microphone; or RIRs of drawn rooms.

    The materials of each RIR are drawn and then scaled until T30 at 1 kHz of the rendered RIR meets a target drawn
    uniformly from a range. All RIRs of a drawn room have the same materials. RIRs of noise sources elsewhere in the
    room share the microphone and the materials.

    The effects of a model act on all RIRs, except that those of loudspeakers do not act on noise sources, and that the
    noise of recordings, `noise_floor`, is left out. Where a row does not state where its source faces, a source with a
    directivity of the model faces as the closed loop has found, or the microphone. Where it does not state a height,
    the model's is used, if it has one. The key `t30_s` of a row holds T30 before effects that act on the whole RIR
    (filters, a second decay); it is what meets the target. The acoustic parameters are those of the RIR as written,
    with all effects.

    Parameters
    ----------
    measured_dir
        RIR directory (`roomeq.records.rir_dir`). Unknown coordinates are drawn. A row may state `materials`: the
        material of the mesh, the wall of the shoebox or ``"default"``, each with what
        `roomeq.sim.materials.find_surface` accepts. They are used instead of drawn ones. A row may state its
        `target_t60_s` as well; null: the materials are not scaled. None: the rooms are drawn.
    out
        RIR directory to make.
    rooms
        Instead of `measured_dir`: the number of rooms to draw, or the first and the last number, ``"101-200"``. What is
        drawn for a room depends on the seed and its number alone.
    room_types
        Distributions that rooms are drawn from (`roomeq.draw_rooms.room_types.read_room_types`).
    t60_range_s
        Range of the targets [s], (0.2, 2.0) by default; ``"measured"``: the range of the measured rooms
        (`roomeq.records.rir_dir.decay_range_s`). Drawn rooms have the times of their types by default.
    num_rays
        Rays per source and per distinct column of scattering coefficients.
    ism_order
        Order of the exact image sources.
    order
        Least number of reflections that rays are followed for; RIRs that decay slowly need more.
    noise_rirs
        RIRs of noise sources per RIR.
    materials
        Table of materials; the one of the package by default.
    model
        File of effects to add to the simulation (`roomeq.effects.model`), as `roomeq close-loop` writes it.
    draw_devices
        Draw the loudspeaker and the microphone of each RIR from the model's `typical` and `spread`, whether the model
        names those of the row or not; the row is written with the names of such devices. Where it does not state where
        its source faces, a source with a directivity of the model faces in a random horizontal direction, instead of
        that of the laboratory. The devices of drawn rooms are always drawn, and face as the types of rooms say.
    diffraction
        Render sound that comes around the edges of meshes.
    fs_hz
        Sample rate of the RIRs, 8 to 48 kHz. The effects of a model are defined at 16 kHz alone.
    part
        ``"2/5"``: do the second of five shares only.
    nj
        Number of processes.

    Raises
    ------
    ValueError
        An option is out of range, a position lies outside its room, the model file is malformed, or a target cannot
        be met.
    """
    if (measured_dir is None) == (rooms is None):
        raise ValueError("RIRs are simulated after measured ones or in drawn rooms: give either MEASURED_DIR and OUT, "
                         "or --rooms and OUT")
    if room_types is not None and rooms is None:
        raise ValueError(f"room_types={room_types} is of drawn rooms: give --rooms as well, or leave it out")
    numbers = None if rooms is None else _room_numbers(rooms)
    measured_dir = None if measured_dir is None else Path(measured_dir)
    times_s = _t60_range_s((0.2, 2.0) if t60_range_s is None and not numbers else t60_range_s, measured_dir)
    options = RenderOptions(times_s, num_rays, ism_order, order, noise_rirs, bool(diffraction), require_fs(fs_hz),
                            seed)
    check_options(options)
    if model and fs_hz != FS_HZ:
        raise ValueError(f"fs={fs_hz} must be {FS_HZ} with model={model}, whose effects are defined at that rate: "
                         "leave one of them out")
    if draw_devices and model is None:
        raise ValueError("draw_devices is of loudspeakers and microphones of a model: give --model as well, or leave "
                         "it out")
    files = [Path(materials or DEFAULT_TABLE), *([Path(model)] if model else [])]
    if measured_dir is None:
        assert numbers is not None
        types = read_room_types(room_types)
        is_file = room_types is not None and Path(room_types).is_file()
        build = _build(out, asdict(options) | dict(rooms=[numbers[0], numbers[-1]],
                                                   room_types=[room_type.name for room_type in types]),
                       [*files, *_published_table(), *([Path(str(room_types))] if is_file else [])])
        if not build.done:
            from roomeq.simulate_rirs.directory import make_drawn

            # the types again, as they are in the key now
            make_drawn(build, numbers, room_types, read_room_types(room_types), materials, model, options, part, nj)
        return
    rows = _rows_of_talkers(measured_dir)
    files += [*(_published_table() if any(row.get("materials") for row in rows) else []),
              *mesh_files(measured_dir)]
    build = _build(out, asdict(options) | dict(draw_devices=draw_devices), files, measured_dir)
    if not build.done:
        from roomeq.simulate_rirs.directory import make

        rows = _rows_of_talkers(measured_dir, say=True)  # again, as they are in the key now
        make(build, measured_dir, rows, materials, model, draw_devices, options, part, nj)


def _rows_of_talkers(measured_dir: Path, say: bool = False) -> list[RirRow]:
    """Return the rows of a directory that are not of noise sources; their target times can be met.

    With `say`, the log has what is not used.
    """
    given = read_rirs(measured_dir)
    rows = [row for row in given if not row.get("noise_for")]
    if say:
        warn_of_unused_keys(measured_dir, given)
        if len(rows) < len(given):
            logger.info("%s: %d RIRs of noise sources (key 'noise_for') are left out: those of the simulated RIRs are "
                        "made anew (--noise-rirs)", measured_dir, len(given) - len(rows))
    if not rows:
        raise ValueError(f"{measured_dir}: all {len(given)} RIRs are of noise sources (key 'noise_for'): give RIRs of "
                         "talkers as well")
    for row in rows:
        target_s = row.get("target_t60_s")
        if target_s is not None and not TARGET_RANGE_S[0] <= target_s <= TARGET_RANGE_S[1]:
            raise ValueError(f"{measured_dir}: RIR {row['id']}: target_t60_s={target_s:g} must lie in [0.05, 10] s, or "
                             "be null to keep the materials: correct the row")
    return rows


def _build(out: Path | str, options: dict[str, Any], files: list[Path], *directories: Path) -> Build:
    return Build(Path(out), step="simulate", options=options,
                 # a file that is absent is refused by its reader, which names what refers to it
                 inputs=[*directories, *(file for file in files if file.exists())])


def _room_numbers(rooms: int | str) -> range:
    """Return the numbers of the rooms to draw: "200" is 1 to 200."""
    match = re.fullmatch(r"(?:(\d{1,9})-)?(\d{1,9})", str(rooms))
    first, last = (int(match[1] or 1), int(match[2])) if match else (0, 0)
    if not 1 <= first <= last < first + MAX_ROOMS:
        raise ValueError(f"rooms={rooms!r} must be a number of rooms, such as 200, or the first and the last, such as "
                         f"201-400; at most {MAX_ROOMS}")
    return range(first, last + 1)


def _t60_range_s(t60_range_s: tuple[float, float] | str | None,
                 measured_dir: Path | None) -> tuple[float, float] | None:
    """Return the range of the targets: as stated, or that of the measured rooms; None for those of the room types."""
    if t60_range_s is None:
        return None
    if isinstance(t60_range_s, str):
        if t60_range_s != "measured" or measured_dir is None:
            raise ValueError(f"t60_range={t60_range_s!r} must be two times [s]"
                             + (" or 'measured'" if measured_dir else ", where no room is measured"))
        try:
            t60_range_s = decay_range_s(read_rirs(measured_dir))
        except ValueError as error:
            raise ValueError(f"{measured_dir}: t60_range=measured: {error}") from None
        logger.info("%s: T60 of the rooms lies between %.2f and %.2f s at 1 kHz", measured_dir, *t60_range_s)
    times_s = tuple(t60_range_s) if isinstance(t60_range_s, Iterable) else (t60_range_s,)
    if len(times_s) != 2 or not all(map(is_number, times_s)) or not (
            TARGET_RANGE_S[0] <= times_s[0] <= times_s[1] <= TARGET_RANGE_S[1]):
        raise ValueError(f"t60_range={t60_range_s} must be two times in [0.05, 10] s, the smaller first: give "
                         "two such as 0.2,2.0")
    return float(times_s[0]), float(times_s[1])


def _published_table() -> list[Path]:
    """Return the published table of materials if it is installed."""
    path = published_file()
    return [path] if path else []
