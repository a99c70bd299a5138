"""Simulate one impulse response for each measured one: its room, drawn materials, drawn reverberation time."""

import json
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomeq.acoustics.parameters import measure
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.effects.model import Model, behind_rendering, direct_gain, extend_scene, names_of, path_gain, read_model
from roomeq.records.rir_dir import decay_range_s, read_rirs, validate_rirs, write_rirs
from roomeq.sim.context import Response
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.geometry import Place, find_place, noise_positions
from roomeq.sim.materials import DEFAULT_TABLE, draw_materials, draw_scattering, given_surfaces, read_materials
from roomeq.sim.path_sample import reference_absorption, sample_paths
from roomeq.sim.published import published_file
from roomeq.sim.response import (
    ISM_ORDER,
    NUM_RAYS,
    ORDER,
    decay_length_s,
    eyring_exponent,
    needed_length_s,
    render_responses,
    render_to_target,
    trace_source,
)
from roomeq.sim.scene import MIN_DISTANCE_M, Air, Material, Scene, with_absorption
from roomeq.sim.target import scaled_absorption

logger = logging.getLogger(__name__)

ROWS_PER_ITEM = 32  # responses of one source that are made together: one trace, little lost when killed
MATERIAL_DRAWS = 4  # for one target
TARGET_DRAWS = 8
NOISE_CANDIDATES = 4
_KEPT = ("room_id", "source_id", "mic_id", "source_dir", "mic_dir", "room_type", "corpus")


def simulate(measured_dir, out, *, t60_range_s=(0.2, 2.0), num_rays=NUM_RAYS, ism_order=ISM_ORDER, order=ORDER,
             noise_rirs=1, materials=None, model=None, diffraction=True, seed=0, part=None, nj=1):
    """Simulate one RIR per measured one, from its room, source and microphone.

    Materials are drawn per RIR and scaled until T30 at 1 kHz of the rendered RIR meets a target drawn uniformly;
    RIRs of noise sources elsewhere in the room share microphone and materials.

    A model's effects act on all RIRs, those of its loudspeakers not on noise sources. `t30_s` of a row is what meets
    the target: that of the rendering, before effects that act behind it (filters, a second decay, noise). The
    parameters is that of the RIR as written, with all of them.

    Parameters
    ----------
    measured_dir : Path
        RIR directory (`roomeq.records.rir_dir`). What its rows don't know of the geometry is drawn. A row's `materials`
        (material of the mesh, wall of the shoebox or ``"default"``, each to what `roomeq.sim.materials.find_surface`
        takes) are used instead of drawn ones; with its `target_t60_s` null as well they are not scaled.
    out : Path
        RIR directory to make.
    t60_range_s : tuple of 2 floats or "measured"
        Range of the targets [s]; "measured": that of the measured rooms (`roomeq.records.rir_dir.decay_range_s`).
    num_rays : int
        Rays per source and distinct scattering column.
    ism_order : int
        Order of the exact image sources.
    order : int
        Reflections that rays are followed for, more where the RIR needs more.
    noise_rirs : int
        RIRs from noise sources for each RIR.
    materials : Path, optional
        Table of materials; default ``conf/materials.toml``.
    model : Path, optional
        Effects that the simulator lacks otherwise, as `roomeq close-loop` found them (`roomeq.effects.model`).
    diffraction : bool
        Whether sound comes around the edges of meshes.
    seed : int
    part : str, optional
        ``"2/5"``: do one share of the work only.
    nj : int
        Number of processes.

    Raises
    ------
    ValueError
        An option is out of range, a position lies outside its room, the model is none, or a target cannot be met.
    """
    measured_dir = Path(measured_dir)
    if t60_range_s == "measured":
        t60_range_s = _measured_range_s(measured_dir)
    _check_options(t60_range_s, num_rays, ism_order, order, noise_rirs)
    table = read_materials(materials)
    effects = Model() if model is None else read_model(model)
    rows = read_rirs(measured_dir)
    groups = _group(rows, measured_dir, seed)
    low_s, high_s = (float(value) for value in t60_range_s)
    options = dict(t60_range_s=[low_s, high_s], num_rays=num_rays, ism_order=ism_order, order=order,
                   noise_rirs=noise_rirs, diffraction=bool(diffraction), seed=seed)
    meshes = sorted({measured_dir / row["mesh"] for row in rows if row.get("mesh")})
    models = [Path(model)] if model else []
    build = Build(out, step="simulate", options=options,
                  inputs=[measured_dir, Path(materials or DEFAULT_TABLE), *meshes, *_published(rows), *models])
    if build.done:
        return

    def one(_, group):
        return _simulate_group(build.work, group, table, effects, options)

    def assemble(directory, records):
        write_rirs(directory, [row for record in records for row in record], final_directory=build.out)
        validate_rirs(directory)

    if build.run(groups, one, part=part, nj=nj):
        build.finish(assemble)
        main = [row for row in read_rirs(out) if not row["noise_for"]]
        logger.info("%s: %d RIRs, T30 of %.2f to %.2f s at 1 kHz, and those of their noise sources", out, len(main),
                    *(edge(row["t30_s"] or 0.0 for row in main) for edge in (min, max)))


def _measured_range_s(measured_dir):
    try:
        low_s, high_s = decay_range_s(read_rirs(measured_dir))
    except ValueError as error:
        raise ValueError(f"{measured_dir}: t60_range=measured: {error}") from None
    logger.info("%s: T60 of %.2f to %.2f s at 1 kHz, room by room", measured_dir, low_s, high_s)
    return low_s, high_s


def _published(rows):
    """The published table of materials, where a row may refer to it and it is installed."""
    path = published_file() if any(row.get("materials") for row in rows) else None
    return [path] if path else []


def _check_options(t60_range_s, num_rays, ism_order, order, noise_rirs):
    if len(t60_range_s) != 2 or not 0.05 <= t60_range_s[0] <= t60_range_s[1] <= 10.0:
        raise ValueError(f"t60_range={t60_range_s} must be two times in [0.05, 10] s, the smaller first")
    for name, value, low, high in (("num_rays", num_rays, 100, 10 ** 7), ("ism_order", ism_order, 0, 20),
                                   ("order", order, 1, 10 ** 4), ("noise_rirs", noise_rirs, 0, NOISE_CANDIDATES)):
        if not low <= value <= high:
            raise ValueError(f"{name}={value} must lie in [{low}, {high}]")


def _group(rows, directory, seed):
    """Put rows of one source together: {name: list of (row, Place)}."""
    by_room = {}
    for row in rows:
        by_room.setdefault(row["room_id"], []).append(row)
    groups = {}
    for row in rows:
        place = find_place(row, by_room[row["room_id"]], directory, seed)
        air = _air(row)
        if place.drawn:
            logger.debug("%s: drawn or moved: %s", row["id"], ", ".join(place.drawn))
        materials = json.dumps(row.get("materials"), sort_keys=True)  # a trace serves one set of scattering
        groups.setdefault((row["room_id"], place.room, place.source_pos_m, air, materials), []).append((row, place))
    n_drawn = sum(bool(place.drawn) for members in groups.values() for _, place in members)
    if n_drawn:
        logger.info("%s: %d of %d RIRs have unknown or unreliable coordinates, which are drawn (key 'drawn')",
                    directory, n_drawn, len(rows))
    items = {}
    for members in groups.values():
        for first in range(0, len(members), ROWS_PER_ITEM):
            share = members[first:first + ROWS_PER_ITEM]
            items[share[0][0]["id"]] = share
    return items


def _air(row):
    """The air of a row: its own temperature and humidity where they are known."""
    known = {key: row[key] for key in ("temperature_c", "humidity_pct") if row.get(key) is not None}
    return Air(**known)


def _simulate_group(work, group, table, model, options):
    """Simulate the rows of one source; return their records."""
    first_row, first_place = group[0]
    room, air, seed = first_place.room, _air(first_row), options["seed"]
    effects = [model.for_row(row, seed) for row, _ in group]
    try:
        given = given_surfaces(table, room, first_row.get("materials"))
    except ValueError as error:
        raise ValueError(f"RIR {first_row['id']}: {error}") from None
    scattering = draw_scattering(table, room, rng_for(seed, "scattering", first_row["room_id"]), given)
    traces = _Traces(room, scattering, air, _of_room(effects[0]), first_row["room_id"], options)
    drawn = [_draw_row(row, traces, table, given, options) for row, _ in group]
    traces.length_s = max(length_s for *_, length_s in drawn)
    path_samples = traces.path_samples(first_place.source_pos_m, traces.length_s, [row["id"] for row, _ in group],
                                       [place.mic_pos_m for _, place in group],
                                       [_at_target(scene, target_s) for _, scene, target_s, _ in drawn])
    made = [_simulate_row(row, place, traces, table, given, *what, one, known, options)
            for (row, place), what, one, known in zip(group, drawn, path_samples, effects, strict=True)]
    noises = _noise_responses(group, made, traces, options)
    records = []
    for (row, _), one, known, others in zip(group, made, effects, noises, strict=True):
        records.append(_write(work, row, one, known, air, seed))
        for n, (source, noise) in enumerate(others, start=1):
            source_id = f"noise-{source[0]}-{source[1]}-{source[2]}"
            noise_row = row | dict(id=f"{row['id']}-noise{n}", source_id=source_id, source_dir=None)
            moved = replace(one, place=replace(one.place, source_pos_m=tuple(source)), response=noise, target_s=None)
            heard = [effect for effect in known if effect.SCOPE not in ("source", "rir")]
            records.append(_write(work, noise_row, moved, heard, air, seed, noise_for=row["id"]))
    return records


def _of_room(effects):
    """The effects that all RIRs of a room share."""
    return [effect for effect in effects if effect.SCOPE in ("all", "room")]


@dataclass(frozen=True)
class _Made:
    """One response, what it was made of and for."""

    place: Place
    scene: Scene
    response: Response
    target_s: float | None
    length_s: float


def _at_target(scene, target_s):
    """Absorption of a scene about as it will be when it meets its target."""
    return scene.absorption if target_s is None else scaled_absorption(
        scene.absorption, eyring_exponent(scene, target_s))


class _Traces:
    """Traced sources of one room, each made when first asked for."""

    def __init__(self, room, scattering, air, effects, room_id, options):
        self.room, self.scattering, self.air, self.effects, self.room_id = room, scattering, air, effects, room_id
        self.options, self.length_s = options, 0.0
        self._known = {}

    def of(self, source_pos_m, length_s):
        """The trace of a source, followed at least so long."""
        length_s = max(length_s, self.length_s)
        key = (*source_pos_m, length_s)
        if key not in self._known:
            scene = extend_scene(self.effects, Scene(self.room, [
                Material(surface, 0.0, tuple(row)) for surface, row in zip(self.room.surfaces, self.scattering, strict=True)],
                self.air))
            rng = rng_for(self.options["seed"], "trace", repr((self.room_id, tuple(source_pos_m))))
            self._known[key] = trace_source(scene, source_pos_m, num_rays=self.options["num_rays"],
                                            max_length_s=length_s, rng=rng)
        return self._known[key]

    def path_samples(self, source_pos_m, length_s, ids, mics_m, absorptions):
        """Sampled paths from a source to the microphones of some RIRs, each for about its own absorption."""
        traced = self.of(source_pos_m, length_s)
        lengths_s = [decay_length_s(traced.scene, absorption) for absorption in absorptions]
        rngs = [rng_for(self.options["seed"], "echoes", row_id) for row_id in ids]
        n_frames = [int(np.ceil(min(length_s, traced.max_length_s) / FRAME_S)) for length_s in lengths_s]
        return sample_paths(traced, mics_m, reference_absorption(np.array(absorptions)), rngs,
                            ism_order=self.options["ism_order"], n_frames=n_frames)

    def drawn(self, table, target_s, rng, given):
        """The room with materials drawn."""
        return extend_scene(self.effects, draw_materials(table, self.room, self.scattering, self.air, target_s, rng,
                                                         given))


def _draw_row(row, traces, table, given, options):
    """Draw what a row is to sound like: (rng for more materials, scene, target or None, length)."""
    seed = options["seed"]
    target_s = float(rng_for(seed, "t60", row["id"]).uniform(*options["t60_range_s"]))
    rng = rng_for(seed, "materials", row["id"])
    scene = traces.drawn(table, target_s, rng, given)
    if row.get("materials"):  # a row that says what it is made of may say how it sounds: null, as it is
        target_s = row.get("target_t60_s", target_s)
    return rng, scene, target_s, needed_length_s(scene, target_s, options["order"])


def _simulate_row(row, place, traces, table, given, rng, scene, target_s, length_s, path_sample, effects, options):
    """Render one row, with other materials or another target where it cannot be met."""
    how = dict(ism_order=options["ism_order"], diffraction=options["diffraction"],
               path_gain=path_gain(effects, row.get("source_dir")))
    for draw in range(1, MATERIAL_DRAWS * TARGET_DRAWS + 1):
        try:
            if length_s > traces.length_s:  # the rays are followed further, for this row alone
                (path_sample,) = traces.path_samples(place.source_pos_m, length_s, [row["id"]], [place.mic_pos_m],
                                                     [_at_target(scene, target_s)])
            response = _rendered(traces.of(place.source_pos_m, length_s), place.mic_pos_m,
                                 rng_for(options["seed"], "tail", row["id"]), target_s, absorption=scene.absorption,
                                 length_s=length_s, path_samples=[path_sample], **how)
            break
        except ValueError as error:
            if draw == MATERIAL_DRAWS * (1 if row.get("materials") else TARGET_DRAWS):
                raise ValueError(f"RIR {row['id']}: {error}") from None
            if draw % MATERIAL_DRAWS == 0:  # this room, at this distance, cannot sound like that
                logger.info("%s: %s; drawing another target", row["id"], error)
                target_s = float(rng.uniform(*options["t60_range_s"]))
            scene = traces.drawn(table, target_s, rng, given)
            length_s = needed_length_s(scene, target_s, options["order"])
    if draw > MATERIAL_DRAWS:
        place = replace(place, drawn=(*place.drawn, "target_t60_s again"))
    return _Made(place, scene, response, target_s, length_s)


def _noise_responses(group, made, traces, options):
    """Render the noise sources of all rows, source by source: for each row a list of (position, Response)."""
    wanted = [_noise_sources(one.place, row, options["seed"], options["noise_rirs"])
              for (row, _), one in zip(group, made, strict=True)]
    rendered = {}
    for source in sorted({tuple(source) for sources in wanted for source in sources}):
        places = [(n, k) for n, sources in enumerate(wanted) for k, one in enumerate(sources) if tuple(one) == source]
        ids = [f"{group[n][0]['id']}-noise{k + 1}" for n, k in places]
        length_s = max(made[n].length_s for n, _ in places)
        path_samples = traces.path_samples(source, length_s, ids, [made[n].place.mic_pos_m for n, _ in places],
                                           [made[n].response.absorption for n, _ in places])
        for (n, k), noise_id, path_sample in zip(places, ids, path_samples, strict=True):
            (rendered[n, k],) = render_responses(
                traces.of(source, length_s), [made[n].place.mic_pos_m], [rng_for(options["seed"], "tail", noise_id)],
                absorption=made[n].response.absorption, length_s=made[n].length_s, path_samples=[path_sample],
                ism_order=options["ism_order"], diffraction=options["diffraction"])
    return [[(source, rendered[n, k]) for k, source in enumerate(sources)] for n, sources in enumerate(wanted)]


def _rendered(traced, mic, rng, target_s, **how):
    if target_s is None:
        (response,) = render_responses(traced, [mic], [rng], **how)
    else:
        (response,) = render_to_target(traced, [mic], [rng], target_s, **how)
    return response


def _noise_sources(place, row, seed, count):
    """The first few of the room's noise positions that keep clear of microphone and source."""
    candidates = noise_positions(place.room, row["room_id"], seed, 2 * NOISE_CANDIDATES)
    distance_m = [min(np.linalg.norm(np.subtract(one, place.mic_pos_m)),
                      np.linalg.norm(np.subtract(one, place.source_pos_m))) for one in candidates]
    clear = [one for one, apart_m in zip(candidates, distance_m, strict=True) if apart_m >= 0.3]
    by_distance = [candidates[n] for n in np.argsort(distance_m)[::-1] if distance_m[n] >= MIN_DISTANCE_M]
    return (clear if len(clear) >= count else by_distance)[:count]


def _write(work, row, one, effects, air, seed, noise_for=None):
    """Write one response with its effects below `work` and return its row; `air` is as declared."""
    place, scene, response = one.place, one.scene, one.response
    name = f"wav/{row['id']}.wav"
    gain = path_gain(effects, row.get("source_dir"))
    direct = direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain) * response.direct_visible
    rir = behind_rendering(effects, response.rir, with_absorption(scene, response.absorption), place.source_pos_m,
                           place.mic_pos_m, direct, rng_for(seed, "effects", row["id"]))
    write_wav(work / name, rir)
    surfaces = zip(scene.room.surfaces, scene.materials, response.absorption, strict=True)
    made = {key: row.get(key) for key in _KEPT if key in row}
    if row.get("mesh"):
        made["mesh"] = row["mesh"]
    else:
        made["room_dims_m"] = list(place.room.dims_m)
    return made | dict(
        id=row["id"], wav=name, fs_hz=FS_HZ, n_samples=len(rir),
        source_pos_m=list(place.source_pos_m), mic_pos_m=list(place.mic_pos_m), drawn=list(place.drawn),
        temperature_c=air.temperature_c, humidity_pct=air.humidity_pct, seed=seed,
        model=["diffraction"] * response.diffracted + names_of(effects, gain),
        target_t60_s=one.target_s, t30_s=response.t30_s, leaked_share=response.leaked_share,
        direct_sample=response.direct_sample, direct_polarity=1, direct_visible=response.direct_visible,
        noise_for=noise_for, measured_id=noise_for or row["id"],
        acoustic_parameters=measure(rir, direct=(response.direct_sample, 1)),
        materials={surface: dict(material=material.name, absorption=[round(float(a), 6) for a in absorption],
                              scattering=list(material.scattering))
                   for surface, material, absorption in surfaces})
