"""Simulate an RIR directory: group the measured rows by source, render each group, write audio and rows.

One group, the rows that share a room, a source position, the air and the stated materials, is rendered in
`roomeq.simulate_rirs.source`.
"""

import json
import logging
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from roomeq.acoustics.parameters import measure
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import write_text
from roomeq.core.groups import numbers_by
from roomeq.core.rng import rng_for
from roomeq.draw_rooms.draw import draw_room, room_id
from roomeq.draw_rooms.room_types import RoomType, types_file
from roomeq.effects.model import Model, apply_to_rir, direct_gain, names_of, path_gain, read_model
from roomeq.effects.source_directivity import unit_facing
from roomeq.records.rir_dir import read_rirs, validate_rirs, with_meshes_relocated, write_rirs
from roomeq.records.schema import RirRow, make_id, stated_air
from roomeq.sim.array_noise import ArrayNoise
from roomeq.sim.geometry import find_place, towards_microphone
from roomeq.sim.materials import read_materials
from roomeq.sim.ray_limits import FEW_RAYS_DB, FEWEST_TO_TELL
from roomeq.sim.scene import Air, Shoebox, require_apart, with_absorption
from roomeq.simulate_rirs.drawn_room import MESHES, render_drawn_room, table_of_type
from roomeq.simulate_rirs.options import RenderOptions
from roomeq.simulate_rirs.source import Member, RenderedRir, channels_of, render_rows, source_directivity

logger = logging.getLogger(__name__)

ROWS_PER_ITEM = 32  # of a room, rendered together: sources are traced once, and there is little to repeat when killed
_KEPT_KEYS = ("room_id", "source_id", "mic_id", "source_dir", "mic_dir", "room_type", "corpus",
              "source_directivity")


def make(build: Build, measured_dir: Path, rows: list[RirRow], materials: Path | str | None, model: Path | str | None,
         draw_devices: bool, options: RenderOptions, part: str | None, nj: int) -> None:
    """Make the RIR directory of a build from measured rows.

    Raises
    ------
    ValueError
        See `roomeq.simulate_rirs.simulate`.
    """
    table = read_materials(materials)
    effects = _model_of_responses(model)
    groups = _group_by_room(rows, measured_dir, effects, draw_devices, options.seed)

    def simulate_group(_: str, members: list[Member]) -> list[dict]:
        air = _declared_air(members[0].row)
        return [_write_rir(build.work, rendered, air, options, True)
                for rendered in render_rows(members, air, table, effects, options)]

    def assemble(directory: Path, records: list[list[dict]]) -> None:
        rows = with_meshes_relocated((row for record in records for row in record), measured_dir, build.out)
        write_rirs(directory, rows, final_directory=build.out)
        validate_rirs(directory)

    if build.run(groups, simulate_group, part=part, nj=nj):
        build.finish(assemble)
        everything = read_rirs(build.out)
        times_s = [row["t30_s"] or 0.0 for row in everything if not row["noise_for"]]
        logger.info("%s: %d RIRs with T30 from %.2f to %.2f s at 1 kHz, and %d of noise sources", build.out,
                    len(times_s), min(times_s), max(times_s), len(everything) - len(times_s))
        _warn_of_few_rays(everything, build.out, options)


def make_drawn(build: Build, numbers: range, room_types: Path | str | None, types: list[RoomType],
               materials: Path | str | None, model: Path | str | None, options: RenderOptions, part: str | None,
               nj: int) -> None:
    """Make the RIR directory of a build from rooms that are drawn by their numbers, of types as `room_types` chose.

    Raises
    ------
    ValueError
        See `roomeq.simulate_rirs.simulate`.
    """
    table = read_materials(materials)
    tables = {room_type.name: table_of_type(table, room_type, str(types_file(room_types))) for room_type in types}
    effects = _model_of_responses(model)

    def simulate_room(_: str, number: int) -> list[dict]:
        drawn = draw_room(number, types, options.seed)
        if not drawn.shape.is_shoebox:
            write_text(build.work / MESHES / f"{drawn.id}.obj", drawn.shape.obj())
        return [_write_rir(build.work, rendered, drawn.air, options, False)
                for rendered in render_drawn_room(drawn, tables[drawn.room_type.name], effects, options)]

    def assemble(directory: Path, records: list[list[dict]]) -> None:
        write_rirs(directory, (row for record in records for row in record), final_directory=build.out)
        validate_rirs(directory)

    if build.run({room_id(number): number for number in numbers}, simulate_room, part=part, nj=nj):
        build.finish(assemble)
        everything = read_rirs(build.out)
        rows = [row for row in everything if not row["noise_for"]]
        types_text = ", ".join(f"{count} of type {name}" for name, count in sorted(_rooms_by_type(rows).items()))
        logger.info("%s: %d RIRs, and %d of noise sources, of %d rooms (%s)", build.out, len(rows),
                    len(everything) - len(rows), len(numbers), types_text)
        _warn_of_few_rays(everything, build.out, options)


def _warn_of_few_rays(rows: Sequence[RirRow], directory: Path, options: RenderOptions) -> None:
    """Say in how many RIRs the decay of an octave is that of a few rays, or that nothing tells it."""
    if options.num_rays < FEWEST_TO_TELL:
        logger.info("%s: %d rays do not tell whether the decay of an octave is that of a few of them (few_rays_db): %d "
                    "do (--num-rays)", directory, options.num_rays, FEWEST_TO_TELL)
    if count := sum((row.get("few_rays_db") or 0.0) > FEW_RAYS_DB for row in rows):
        logger.warning("%s: in %d of %d RIRs, few rays tell the decay of an octave (few_rays_db above %g), whose T30 "
                       "is uncertain by 10 %%: trace more than %d rays (--num-rays)", directory, count, len(rows),
                       FEW_RAYS_DB, options.num_rays)


def _model_of_responses(path: Path | str | None) -> Model:
    """Return a model without effects that are no part of a response: speech would keep sounding in such noise."""
    if path is None:
        return Model()
    model = read_model(path)
    kept = tuple(extension for extension in model.extensions if extension.effect.IN_RESPONSE)
    for extension in model.extensions:
        if not extension.effect.IN_RESPONSE:
            logger.info("%s: %s is of the recordings and no part of a room impulse response: it is not simulated", path,
                        extension.effect.NAME)
    return replace(model, extensions=kept)


def _rooms_by_type(rows: list[RirRow]) -> Counter[str]:
    return Counter(dict((row["room_id"], row.get("room_type") or "") for row in rows).values())


def _group_by_room(rows: list[RirRow], directory: Path, model: Model, draw_devices: bool, seed: int
                   ) -> dict[str, list[Member]]:
    """Return at most `ROWS_PER_ITEM` rows of one room each, source by source, by the id of the first row.

    A directivity of the model needs to know where sources face. Where a row does not state it, that is the direction
    in which the loop has found the source to face, or that of the microphone, which the loop assumes otherwise. With
    `draw_devices`, it is drawn, and each row has a loudspeaker and a microphone of its own, which the model does not
    name. Heights that rows do not state are those that the loop has found.
    """
    given, rows = rows, [model.with_heights(row) for row in rows]
    rows_of_room = defaultdict(list)
    for row in rows:
        rows_of_room[row["room_id"]].append(row)
    groups = defaultdict(list)
    n_drawn = n_unknown_arrays = n_faced = 0
    drawn_keys: Counter[str] = Counter()
    for row in rows:
        place = find_place(row, rows_of_room[row["room_id"]], directory, seed)
        try:
            require_apart(place.source_pos_m, place.mic_pos_m)
        except ValueError as error:  # here, since no other target or material could mend it
            raise ValueError(f"RIR {row['id']}: {error}") from None
        if row.get("source_directivity") and unit_facing(row.get("source_dir")) is None:
            raise ValueError(f"RIR {row['id']}: source_directivity needs to know where the source faces: add "
                             "source_dir, or remove it")
        if model.is_directive and unit_facing(row.get("source_dir")) is None:
            n_faced += 1
            facing = (_drawn_facing(row["id"], seed) if draw_devices
                      else model.facings.get(row["id"], towards_microphone(place)))
            row = {**row, "source_dir": [float(x) for x in facing]}
        if draw_devices:
            device = make_id(f"drawn-{row['id']}")
            row = {**row, "source_id": device, "mic_id": device}
        if place.drawn:
            n_drawn += 1
            drawn_keys.update({name.partition(".")[0] for name in place.drawn})
            logger.debug("%s: drawn or moved: %s", row["id"], ", ".join(place.drawn))
        n_unknown_arrays += bool(row.get("channel_pos_m") and not place.channels_m)
        materials = json.dumps(row.get("materials"), sort_keys=True)  # a trace serves one set of scattering
        groups[row["room_id"], place.room, _declared_air(row), materials].append(Member(row, place))
    if n_with_heights := sum(one is not other for one, other in zip(given, rows, strict=True)):
        logger.info("%s: %d of %d RIRs do not state the height of their source or microphone: it is as the closed loop "
                    "has found", directory, n_with_heights, len(rows))
    if n_drawn:
        logger.info("%s: %d of %d RIRs have coordinates that are unknown or unreliable, and are drawn, or that lie "
                    "on a surface, and are moved off it (key 'drawn'): %s",
                    directory, n_drawn, len(rows),
                    ", ".join(f"{key} of {count}" for key, count in sorted(drawn_keys.items())))
    if n_faced:
        logger.info("%s: %d of %d RIRs do not state where their source faces (source_dir): %s", directory, n_faced,
                    len(rows), "that is drawn" if draw_devices
                    else "it faces as the closed loop has found, or the microphone")
    if draw_devices:
        logger.info("%s: the loudspeaker and the microphone of each of %d RIRs are drawn", directory, len(rows))
    if n_unknown_arrays:
        logger.info("%s: %d RIRs are of arrays with unknown coordinates in channel_pos_m: only their first microphone "
                    "is simulated", directory, n_unknown_arrays)
    return {item[0].row["id"]: item for members in groups.values() for item in _items_of_room(members)}


def _items_of_room(members: list[Member]) -> list[list[Member]]:
    """Divide the rows of a room between items; only a source of more than `ROWS_PER_ITEM` rows is in several."""
    items: list[list[Member]] = []
    for numbers in numbers_by(member.place.source_pos_m for member in members).values():
        for first in range(0, len(numbers), ROWS_PER_ITEM):
            of_source = [members[n] for n in numbers[first:first + ROWS_PER_ITEM]]
            if items and len(items[-1]) + len(of_source) <= ROWS_PER_ITEM:
                items[-1] += of_source
            else:
                items.append(of_source)
    return items


def _drawn_facing(rir_id: str, seed: int) -> list[float]:
    """Return a horizontal direction, uniform in azimuth."""
    azimuth_rad = rng_for(seed, "facing", rir_id).uniform(0.0, 2.0 * np.pi)
    return [float(np.cos(azimuth_rad)), float(np.sin(azimuth_rad)), 0.0]


def _declared_air(row: RirRow) -> Air:
    """Return the air of a row: its temperature and humidity where they are known, else the defaults."""
    try:
        return Air(**stated_air(row))
    except ValueError as error:
        raise ValueError(f"RIR {row['id']}: {error}") from None


def _write_rir(work: Path, rendered: RenderedRir, air: Air, options: RenderOptions, measured: bool) -> dict:
    """Apply the effects that act on the whole RIR, write the audio below `work`, return the row; `air` as declared.

    `measured`: whether the RIR is simulated after a measured one.
    """
    row, place, scene, response = rendered.row, rendered.place, rendered.scene, rendered.response
    gain = path_gain(rendered.effects, row.get("source_dir"))
    channels = _apply_effects(rendered, options.seed)
    rir = channels[0]
    wav = f"wav/{row['id']}.wav"
    write_wav(work / wav, rir if len(channels) == 1 else np.stack(channels, axis=1), options.fs_hz)
    changed: dict[str, object] = {}
    if place.channels_m:
        changed["channel_pos_m"] = [list(position) for position in place.channels_m]
    if gain is not None and row.get("source_directivity"):
        changed["source_directivity"] = None  # that of the model takes its place
    room: dict[str, object] = (dict(room_dims_m=list(place.room.dims_m)) if isinstance(place.room, Shoebox)
                               else dict(mesh=row["mesh"]))
    surfaces = zip(scene.room.surfaces, scene.materials, response.absorption, strict=True)
    return {key: row.get(key) for key in _KEPT_KEYS if key in row} | room | changed | dict(
        id=row["id"], wav=wav, fs_hz=options.fs_hz, n_samples=len(rir),
        source_pos_m=list(place.source_pos_m), mic_pos_m=list(place.mic_pos_m), drawn=list(place.drawn),
        temperature_c=air.temperature_c, humidity_pct=air.humidity_pct, seed=options.seed,
        model=["diffraction"] * response.diffracted + names_of(rendered.effects, gain),
        target_t60_s=rendered.target_s, t30_s=response.t30_s, leaked_share=response.leaked_share,
        few_rays_db=None if response.few_rays_db is None else max(
            one.few_rays_db or 0.0 for one in (response, *rendered.others)),
        direct_sample=response.direct_sample, direct_polarity=1, direct_visible=response.direct_visible,
        noise_for=rendered.noise_for, measured_id=(rendered.noise_for or row["id"]) if measured else None,
        acoustic_parameters=measure(rir, options.fs_hz, direct=(response.direct_sample, 1)),
        materials={surface: dict(material=material.name, absorption=_to_8_khz(absorption),
                                 scattering=list(material.scattering))
                   for surface, material, absorption in surfaces})


def _apply_effects(rendered: RenderedRir, seed: int) -> list[FloatArray]:
    """Return the response at each microphone with the effects that act on the whole RIR."""
    responses = [rendered.response, *rendered.others]
    channels = _of_one_length([response.rir for response in responses])
    if not rendered.effects:
        return channels
    scene, source_pos_m = rendered.scene, rendered.place.source_pos_m
    named = channels_of(rendered.row, rendered.place)
    array = None if len(named) == 1 else ArrayNoise(
        [position for _, position in named], scene.room.volume_m3, scene.air.speed_m_s, scene.fs_hz,
        [rng_for(seed, "noise of effects", name) for name, _ in named])
    gain = source_directivity(rendered.row, rendered.effects, scene.fs_hz)
    changed = []
    for n, (response, rir, (name, mic_pos_m)) in enumerate(zip(responses, channels, named, strict=True)):
        direct = direct_gain(scene, source_pos_m, mic_pos_m, gain) * response.direct_visible
        changed.append(apply_to_rir(
            rendered.effects, rir, with_absorption(scene, response.absorption), source_pos_m, mic_pos_m, direct,
            rng_for(seed, "effects", name), diffuse_noise=None if array is None else partial(array.at_microphone, n)))
    return _of_one_length(changed)


def _of_one_length(channels: list[FloatArray]) -> list[FloatArray]:
    """Return responses continued with zeros to the longest."""
    longest = max(map(len, channels))
    return [np.pad(channel, (0, longest - len(channel))) for channel in channels]


def _to_8_khz(absorption: FloatArray) -> list[float]:
    """Return coefficients as tables hold them, from 62.5 Hz to 8 kHz at least: missing bands take the last value."""
    values = [round(float(value), 6) for value in absorption]
    return values + values[-1:] * (len(BANDS_HZ) - len(values))
