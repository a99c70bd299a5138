"""Simulate an RIR directory: group the measured rows by source, render each group, write audio and rows.

One group, the rows that share a room, a source position, the air and the stated materials, is rendered in
`roomeq.simulate_rirs.source`.
"""

import json
import logging
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roomeq.acoustics.parameters import measure
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import BANDS_HZ
from roomeq.core.rng import rng_for
from roomeq.effects.model import Model, apply_to_rir, direct_gain, names_of, path_gain, read_model
from roomeq.records.rir_dir import read_rirs, validate_rirs, with_meshes_relocated, write_rirs
from roomeq.records.schema import RirRow
from roomeq.sim.geometry import find_place
from roomeq.sim.materials import read_materials
from roomeq.sim.scene import Air, Shoebox, with_absorption
from roomeq.simulate_rirs.options import RenderOptions
from roomeq.simulate_rirs.source import Member, RenderedRir, render_source

logger = logging.getLogger(__name__)

ROWS_PER_ITEM = 32  # responses of one source that are rendered together: one trace, and little to repeat when killed
_KEPT_KEYS = ("room_id", "source_id", "mic_id", "source_dir", "mic_dir", "room_type", "corpus")


def make(build: Build, measured_dir: Path, rows: list[RirRow], materials: Path | str | None, model: Path | str | None,
         options: RenderOptions, part: str | None, nj: int) -> None:
    """Make the RIR directory of a build from measured rows.

    Raises
    ------
    ValueError
        See `roomeq.simulate_rirs.simulate`.
    """
    table = read_materials(materials)
    effects = Model() if model is None else read_model(model)
    groups = _group_by_source(rows, measured_dir, options.seed)

    def simulate_group(_: str, members: list[Member]) -> list[dict]:
        air = _declared_air(members[0].row)
        return [_write_rir(build.work, rendered, air, options)
                for rendered in render_source(members, air, table, effects, options)]

    def assemble(directory: Path, records: list[list[dict]]) -> None:
        rows = with_meshes_relocated((row for record in records for row in record), measured_dir, build.out)
        write_rirs(directory, rows, final_directory=build.out)
        validate_rirs(directory)

    if build.run(groups, simulate_group, part=part, nj=nj):
        build.finish(assemble)
        times_s = [row["t30_s"] or 0.0 for row in read_rirs(build.out) if not row["noise_for"]]
        logger.info("%s: %d RIRs with T30 from %.2f to %.2f s at 1 kHz, and RIRs of their noise sources", build.out,
                    len(times_s), min(times_s), max(times_s))


def _group_by_source(rows: list[RirRow], directory: Path, seed: int) -> dict[str, list[Member]]:
    """Return at most `ROWS_PER_ITEM` rows of one source each, by the id of the first row."""
    rows_of_room = defaultdict(list)
    for row in rows:
        rows_of_room[row["room_id"]].append(row)
    groups = defaultdict(list)
    n_drawn = 0
    for row in rows:
        place = find_place(row, rows_of_room[row["room_id"]], directory, seed)
        if place.drawn:
            n_drawn += 1
            logger.debug("%s: drawn or moved: %s", row["id"], ", ".join(place.drawn))
        materials = json.dumps(row.get("materials"), sort_keys=True)  # a trace serves one set of scattering
        key = row["room_id"], place.room, place.source_pos_m, _declared_air(row), materials
        groups[key].append(Member(row, place))
    if n_drawn:
        logger.info("%s: %d of %d RIRs have unknown or unreliable coordinates, which are drawn (key 'drawn')",
                    directory, n_drawn, len(rows))
    return {members[first].row["id"]: members[first:first + ROWS_PER_ITEM]
            for members in groups.values() for first in range(0, len(members), ROWS_PER_ITEM)}


def _declared_air(row: RirRow) -> Air:
    """Return the air of a row: its temperature and humidity where they are known, else the defaults."""
    values: Mapping[str, Any] = row
    return Air(**{key: values[key] for key in ("temperature_c", "humidity_pct") if values.get(key) is not None})


def _write_rir(work: Path, rendered: RenderedRir, air: Air, options: RenderOptions) -> dict:
    """Apply the effects that act on the whole RIR, write the audio below `work`, return the row; `air` as declared."""
    row, place, scene, response, rir = (rendered.row, rendered.place, rendered.scene, rendered.response,
                                        rendered.response.rir)
    gain = path_gain(rendered.effects, row.get("source_dir"))
    if rendered.effects:
        direct = direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain) * response.direct_visible
        rir = apply_to_rir(rendered.effects, rir, with_absorption(scene, response.absorption), place.source_pos_m,
                           place.mic_pos_m, direct, rng_for(options.seed, "effects", row["id"]))
    wav = f"wav/{row['id']}.wav"
    write_wav(work / wav, rir, options.fs_hz)
    room: dict[str, object] = (dict(room_dims_m=list(place.room.dims_m)) if isinstance(place.room, Shoebox)
                               else dict(mesh=row["mesh"]))
    surfaces = zip(scene.room.surfaces, scene.materials, response.absorption, strict=True)
    return {key: row.get(key) for key in _KEPT_KEYS if key in row} | room | dict(
        id=row["id"], wav=wav, fs_hz=options.fs_hz, n_samples=len(rir),
        source_pos_m=list(place.source_pos_m), mic_pos_m=list(place.mic_pos_m), drawn=list(place.drawn),
        temperature_c=air.temperature_c, humidity_pct=air.humidity_pct, seed=options.seed,
        model=["diffraction"] * response.diffracted + names_of(rendered.effects, gain),
        target_t60_s=rendered.target_s, t30_s=response.t30_s, leaked_share=response.leaked_share,
        direct_sample=response.direct_sample, direct_polarity=1, direct_visible=response.direct_visible,
        noise_for=rendered.noise_for, measured_id=rendered.noise_for or row["id"],
        acoustic_parameters=measure(rir, options.fs_hz, direct=(response.direct_sample, 1)),
        materials={surface: dict(material=material.name, absorption=_to_8_khz(absorption),
                                 scattering=list(material.scattering))
                   for surface, material, absorption in surfaces})


def _to_8_khz(absorption: FloatArray) -> list[float]:
    """Return coefficients as tables hold them, from 62.5 Hz to 8 kHz at least: missing bands take the last value."""
    values = [round(float(value), 6) for value in absorption]
    return values + values[-1:] * (len(BANDS_HZ) - len(values))
