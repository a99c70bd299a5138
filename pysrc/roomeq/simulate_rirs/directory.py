"""Simulate an RIR directory: group the measured rows by source, render each group, write audio and rows.

One group, the rows that share a room, a source position, the air and the stated materials, is rendered in
`roomeq.simulate_rirs.source`.
"""

import json
import logging
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from roomeq.acoustics.parameters import measure
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.effects.model import Model, apply_to_rir, direct_gain, names_of, path_gain, read_model
from roomeq.records.rir_dir import decay_range_s, read_rirs, validate_rirs, write_rirs
from roomeq.records.schema import RirRow
from roomeq.sim.geometry import find_place
from roomeq.sim.materials import DEFAULT_TABLE, read_materials
from roomeq.sim.published import published_file
from roomeq.sim.response import ISM_ORDER, NUM_RAYS, ORDER
from roomeq.sim.scene import Air, Shoebox, with_absorption
from roomeq.simulate_rirs.source import NOISE_CANDIDATES, Member, RenderedRir, RenderOptions, render_source

logger = logging.getLogger(__name__)

ROWS_PER_ITEM = 32  # responses of one source that are rendered together: one trace, and little to repeat when killed
_KEPT_KEYS = ("room_id", "source_id", "mic_id", "source_dir", "mic_dir", "room_type", "corpus")


def simulate(measured_dir: Path | str, out: Path | str, *, t60_range_s: tuple[float, float] | str = (0.2, 2.0),
             num_rays: int = NUM_RAYS, ism_order: int = ISM_ORDER, order: int = ORDER, noise_rirs: int = 1,
             materials: Path | str | None = None, model: Path | str | None = None, diffraction: bool = True,
             seed: int = 0, part: str | None = None, nj: int = 1) -> None:
    """Simulate one RIR per measured RIR, in its room and from its source to its microphone.

    The materials of each RIR are drawn and then scaled until T30 at 1 kHz of the rendered RIR meets a target drawn
    uniformly from a range. RIRs of noise sources elsewhere in the room share the microphone and the materials.

    The effects of a model act on all RIRs, except that those of loudspeakers do not act on noise sources. The key
    `t30_s` of a row holds T30 before effects that act on the whole RIR (filters, a second decay, noise); it is what
    meets the target. The acoustic parameters are those of the RIR as written, with all effects.

    Parameters
    ----------
    measured_dir
        RIR directory (`roomeq.records.rir_dir`). Unknown coordinates are drawn. A row may state `materials`: the
        material of the mesh, the wall of the shoebox or ``"default"``, each with what
        `roomeq.sim.materials.find_surface` accepts. They are used instead of drawn ones. If its `target_t60_s` is
        null as well, they are not scaled.
    out
        RIR directory to make.
    t60_range_s
        Range of the targets [s]; ``"measured"``: the range of the measured rooms
        (`roomeq.records.rir_dir.decay_range_s`).
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
    diffraction
        Render sound that comes around the edges of meshes.
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
    measured_dir = Path(measured_dir)
    low_s, high_s = _t60_range_s(t60_range_s, measured_dir)
    options = RenderOptions((low_s, high_s), num_rays, ism_order, order, noise_rirs, bool(diffraction), seed)
    _check_options(options)
    table = read_materials(materials)
    effects = Model() if model is None else read_model(model)
    rows = read_rirs(measured_dir)
    groups = _group_by_source(rows, measured_dir, seed)
    meshes = sorted({measured_dir / mesh for row in rows if (mesh := row.get("mesh"))})
    models = [Path(model)] if model else []
    build = Build(Path(out), step="simulate", options=asdict(options),
                  inputs=[measured_dir, Path(materials or DEFAULT_TABLE), *meshes, *_published_table(rows), *models])
    if build.done:
        return

    def simulate_group(_: str, members: list[Member]) -> list[dict]:
        air = _declared_air(members[0].row)
        return [_write_rir(build.work, rendered, air, seed)
                for rendered in render_source(members, air, table, effects, options)]

    def assemble(directory: Path, records: list[list[dict]]) -> None:
        write_rirs(directory, [row for record in records for row in record], final_directory=build.out)
        validate_rirs(directory)

    if build.run(groups, simulate_group, part=part, nj=nj):
        build.finish(assemble)
        times_s = [row["t30_s"] or 0.0 for row in read_rirs(build.out) if not row["noise_for"]]
        logger.info("%s: %d RIRs with T30 from %.2f to %.2f s at 1 kHz, and RIRs of their noise sources", out,
                    len(times_s), min(times_s), max(times_s))


def _t60_range_s(t60_range_s: tuple[float, float] | str, measured_dir: Path) -> tuple[float, float]:
    """Return the range of the targets: as stated, or that of the measured rooms."""
    if isinstance(t60_range_s, str):
        if t60_range_s != "measured":
            raise ValueError(f"t60_range={t60_range_s!r} must be two times [s] or 'measured'")
        try:
            t60_range_s = decay_range_s(read_rirs(measured_dir))
        except ValueError as error:
            raise ValueError(f"{measured_dir}: t60_range=measured: {error}") from None
        logger.info("%s: T60 of the rooms lies between %.2f and %.2f s at 1 kHz", measured_dir, *t60_range_s)
    if len(t60_range_s) != 2 or not 0.05 <= t60_range_s[0] <= t60_range_s[1] <= 10.0:
        raise ValueError(f"t60_range={t60_range_s} must be two times in [0.05, 10] s, the smaller first")
    return float(t60_range_s[0]), float(t60_range_s[1])


def _check_options(options: RenderOptions) -> None:
    for name, low, high in (("num_rays", 100, 10 ** 7), ("ism_order", 0, 20), ("order", 1, 10 ** 4),
                            ("noise_rirs", 0, NOISE_CANDIDATES)):
        value = getattr(options, name)
        if not low <= value <= high:
            raise ValueError(f"{name}={value} must lie in [{low}, {high}]")


def _published_table(rows: list[RirRow]) -> list[Path]:
    """Return the published table of materials if it is installed and a row may refer to it."""
    path = published_file() if any(row.get("materials") for row in rows) else None
    return [path] if path else []


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


def _write_rir(work: Path, rendered: RenderedRir, air: Air, seed: int) -> dict:
    """Apply the effects that act on the whole RIR, write the audio below `work`, return the row; `air` as declared."""
    row, place, scene, response = rendered.row, rendered.place, rendered.scene, rendered.response
    gain = path_gain(rendered.effects, row.get("source_dir"))
    direct = direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain) * response.direct_visible
    rir = apply_to_rir(rendered.effects, response.rir, with_absorption(scene, response.absorption),
                       place.source_pos_m, place.mic_pos_m, direct, rng_for(seed, "effects", row["id"]))
    wav = f"wav/{row['id']}.wav"
    write_wav(work / wav, rir)
    room: dict[str, object] = (dict(room_dims_m=list(place.room.dims_m)) if isinstance(place.room, Shoebox)
                               else dict(mesh=row["mesh"]))
    surfaces = zip(scene.room.surfaces, scene.materials, response.absorption, strict=True)
    return {key: row.get(key) for key in _KEPT_KEYS if key in row} | room | dict(
        id=row["id"], wav=wav, fs_hz=FS_HZ, n_samples=len(rir),
        source_pos_m=list(place.source_pos_m), mic_pos_m=list(place.mic_pos_m), drawn=list(place.drawn),
        temperature_c=air.temperature_c, humidity_pct=air.humidity_pct, seed=seed,
        model=["diffraction"] * response.diffracted + names_of(rendered.effects, gain),
        target_t60_s=rendered.target_s, t30_s=response.t30_s, leaked_share=response.leaked_share,
        direct_sample=response.direct_sample, direct_polarity=1, direct_visible=response.direct_visible,
        noise_for=rendered.noise_for, measured_id=rendered.noise_for or row["id"],
        acoustic_parameters=measure(rir, direct=(response.direct_sample, 1)),
        materials={surface: dict(material=material.name, absorption=[round(float(a), 6) for a in absorption],
                                 scattering=list(material.scattering))
                   for surface, material, absorption in surfaces})
