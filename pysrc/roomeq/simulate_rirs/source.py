"""Render the responses of a room: draw materials, trace each source once, meet the targets, render noise sources."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ
from roomeq.core.groups import numbers_by
from roomeq.core.rng import rng_for
from roomeq.effects.base import Effect
from roomeq.effects.model import Model, extend_scene, path_gain
from roomeq.records.geometry import MIN_DISTANCE_M
from roomeq.records.schema import TARGET_AGAIN, RirRow
from roomeq.rooms import Loudspeaker
from roomeq.sim.context import Directivity, NotFiniteError, Response
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.geometry import Place, noise_positions
from roomeq.sim.materials import MaterialTable, Surface, draw_materials, draw_scattering, given_surfaces
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.pilot import PilotRays
from roomeq.sim.response import (
    TracedSource,
    decay_length_s,
    eyring_exponent,
    longer_length_s,
    needed_length_s,
    render_responses,
    render_to_target,
    trace_every_ray,
    trace_source,
)
from roomeq.sim.room import Room
from roomeq.sim.scene import Air, Material, Scene
from roomeq.sim.target import scaled_absorption
from roomeq.sim.trace import bytes_per_reflection
from roomeq.simulate_rirs.options import NOISE_CANDIDATES, RenderOptions

logger = logging.getLogger(__name__)

MATERIAL_DRAWS = 4  # per target
TARGET_DRAWS = 8
_SHARED_FROM = 3.0
"""Sum of the lengths of the responses of a source, relative to the longest, from which on it takes less time to follow
all its rays once than those that each response needs."""
_SHARED_BYTES = 3 * 2 ** 27
_NOISE_DISTANCE_M = 0.3  # preferred distance of a noise source from the microphone and from the source


class Member(NamedTuple):
    """A row to simulate, and its geometry."""

    row: RirRow
    place: Place


@dataclass(frozen=True)
class RenderedRir:
    """One rendered response and what it was rendered from.

    Attributes
    ----------
    row : RirRow
        The measured row; of a noise source, a copy with ids of its own.
    scene : Scene
        Before the absorption was scaled to the target.
    effects : list of Effect
        Effects that act on this response.
    target_s : float or None
        T30 at 1 kHz that was asked for; None if the materials are not scaled.
    length_s : float
        How far the rays had to be followed.
    noise_for : str or None
        Id of the RIR whose noise source this is.
    others : tuple of Response
        At the further microphones of an array, `response` being that of the first.
    """

    row: RirRow
    place: Place
    scene: Scene
    response: Response
    effects: list[Effect]
    target_s: float | None
    length_s: float
    noise_for: str | None = None
    others: tuple[Response, ...] = ()


@dataclass(frozen=True)
class SceneDraw:
    """Drawn materials of a room, and the decay time to scale them to."""

    scene: Scene
    target_s: float | None
    length_s: float
    """How far to follow the rays."""
    target_number: int
    """How many targets were given up before."""


def render_rows(members: list[Member], air: Air, table: MaterialTable, model: Model,
                options: RenderOptions) -> list[RenderedRir]:
    """Render rows that share room, air and stated materials.

    Returns
    -------
    list of RenderedRir
        Source by source, for each row its response, followed by those of its noise sources.

    Raises
    ------
    ValueError
        A material is unknown, a target cannot be met, or a response is not finite; the message names the RIR.
    """
    effects = [model.for_row(member.row, options.seed) for member in members]
    first = members[0]
    room = TracedRoom(first.place.room, first.row["room_id"], _stated_surfaces(first, table), air, table, effects[0],
                      options)
    rendered: list[RenderedRir] = []
    for numbers in numbers_by(member.place.source_pos_m for member in members).values():
        rendered += _render_source(room, [members[n] for n in numbers], [effects[n] for n in numbers])
    return with_noises(room, rendered)


def _render_source(room: "TracedRoom", members: list[Member], effects: list[list[Effect]]) -> list[RenderedRir]:
    """Render the rows of one source."""
    draws = [room.draw_scenes(member.row) for member in members]
    first_draws = [next(of_row) for of_row in draws]
    room.share_trace(members[0].place.source_pos_m, [(draw.scene.absorption, draw.target_s, draw.length_s)
                                                     for draw in first_draws])
    return [_render_row(room, member, of_row, chain([draw], further))
            for member, of_row, draw, further in zip(members, effects, first_draws, draws, strict=True)]


def with_noises(room: "TracedRoom", rendered: list[RenderedRir]) -> list[RenderedRir]:
    """Return each response followed by those of its noise sources."""
    return [rir for group in zip(rendered, _render_noises(room, rendered), strict=True)
            for rir in (group[0], *group[1])]


def _whole_frames_s(length_s: float) -> float:
    """Return how far rays are followed for a response of some length: beyond its last frame, for any rounding."""
    return float((np.ceil(length_s / FRAME_S) + 0.5) * FRAME_S)


def _stated_surfaces(member: Member, table: MaterialTable) -> dict[str, Surface]:
    try:
        return given_surfaces(table, member.place.room, member.row.get("materials"))
    except ValueError as error:
        raise ValueError(f"RIR {member.row['id']}: {error}") from None


class _SharedTrace(NamedTuple):
    """The rays of a source, none of which ends early, and how far they were followed [s]."""

    source_pos_m: tuple[float, ...]
    length_s: float
    traced: TracedSource


class TracedRoom:
    """A room with its scattering, and the latest trace of one of its sources."""

    def __init__(self, room: Room, room_id: str, stated: dict[str, Surface], air: Air, table: MaterialTable,
                 effects: list[Effect], options: RenderOptions) -> None:
        self.room, self.room_id, self.stated = room, room_id, stated
        self.air, self.table, self.options = air, table, options
        self.effects = [effect for effect in effects if effect.SCOPE in ("all", "room")]
        self.scattering = draw_scattering(table, room, rng_for(options.seed, "scattering", room_id), stated)
        self._latest: tuple[Any, TracedSource | None] = None, None
        self._shared: _SharedTrace | None = None
        self._latest_pilot: tuple[tuple[float, ...], PilotRays | None] = (), None

    def draw_scenes(self, row: RirRow) -> Iterator[SceneDraw]:
        """Yield materials and targets to try for a row: several draws of materials for each of several targets.

        A row may state its materials, its target, or both, and gets no others; the target None does not scale.
        """
        assert self.options.t60_range_s is not None
        drawn_s = float(rng_for(self.options.seed, "t60", row["id"]).uniform(*self.options.t60_range_s))
        target_s: float | None = row.get("target_t60_s", drawn_s)
        rng, stated = rng_for(self.options.seed, "materials", row["id"]), row.get("materials") or "target_t60_s" in row
        for n in range(MATERIAL_DRAWS * (1 if stated else TARGET_DRAWS)):
            if n and n % MATERIAL_DRAWS == 0:
                target_s = drawn_s = float(rng.uniform(*self.options.t60_range_s))
            scene = self.draw_scene(drawn_s if target_s is None else target_s, rng)
            yield SceneDraw(scene, target_s, needed_length_s(scene, target_s, self.options.order),
                            n // MATERIAL_DRAWS)

    def draw_scene(self, target_s: float | None, rng: np.random.Generator) -> Scene:
        """Draw the materials that are not stated; see `roomeq.sim.materials.draw_materials`."""
        scene = draw_materials(self.table, self.room, self.scattering, self.air, target_s, rng, self.stated)
        return extend_scene(self.effects, replace(scene, fs_hz=self.options.fs_hz))

    def first_length_s(self, absorption: FloatArray, target_s: float | None, followed_s: float) -> float:
        """Return the length to render first: that of Eyring's decay, if the rays are followed so far [s]."""
        if target_s is not None:
            absorption = scaled_absorption(absorption, eyring_exponent(self._scene, target_s, absorption))
        return min(decay_length_s(self._scene, absorption), followed_s)

    def share_trace(self, source_pos_m: tuple[float, ...],
                    wanted: list[tuple[FloatArray, float | None, float]]) -> None:
        """Trace a source once for some responses, whatever their absorption, if that takes less time.

        The responses are the same. Where the trace would take much memory, each gets one of its own, which serves all
        with that absorption. Arguments are those of `first_length_s` for each response.
        """
        self._shared = None
        lengths_s = {(absorption.tobytes(), target_s): self.first_length_s(absorption, target_s, followed_s)
                     for absorption, target_s, followed_s in wanted}
        longest_s = _whole_frames_s(max(lengths_s.values()))
        n_traces = np.unique(self.scattering, axis=1).shape[1]
        per_ray = longest_s * self.air.speed_m_s * self.room.surface_area_m2.sum() / (4.0 * self.room.volume_m3)
        n_bytes = self.options.num_rays * n_traces * per_ray * bytes_per_reflection(self.room)
        if sum(lengths_s.values()) >= _SHARED_FROM * longest_s and n_bytes <= _SHARED_BYTES:
            traced = trace_every_ray(**self._how_to_trace(source_pos_m, longest_s))
            self._shared = _SharedTrace(source_pos_m, longest_s, traced)

    def _trace(self, source_pos_m: tuple[float, ...], length_s: float, expected: FloatArray) -> TracedSource:
        """Return a trace for responses of a length."""
        followed_s, shared = _whole_frames_s(length_s), self._shared
        key = source_pos_m, followed_s, expected.tobytes()
        known, traced = self._latest
        if traced is None or known != key:
            if shared is not None and shared.source_pos_m == source_pos_m and followed_s <= shared.length_s:
                traced = shared.traced.play_roulette(expected, followed_s)
            else:
                traced = trace_source(absorption=expected, **self._how_to_trace(source_pos_m, followed_s))
            self._latest = key, traced
        return traced

    @cached_property
    def _scene(self) -> Scene:
        """The room without absorption."""
        reflecting = [Material(surface, (0.0,) * len(BANDS_HZ), tuple(scattering))
                      for surface, scattering in zip(self.room.surfaces, self.scattering, strict=True)]
        return extend_scene(self.effects, Scene(self.room, reflecting, self.air, self.options.fs_hz))

    def _pilot(self, source_pos_m: tuple[float, ...], length_s: float) -> PilotRays:
        """Return pilot rays of a source for reverberation times up to a length."""
        known, pilot = self._latest_pilot
        if pilot is None or known != source_pos_m or pilot.max_length_s < length_s:
            rng = rng_for(self.options.seed, "pilot", repr((self.room_id, tuple(source_pos_m))))
            longest_s = max(length_s, *(self.options.t60_range_s or (0.0,)))
            pilot = PilotRays(self._scene, source_pos_m, longest_s, rng)
            self._latest_pilot = source_pos_m, pilot
        return pilot

    def _how_to_trace(self, source_pos_m: tuple[float, ...], length_s: float) -> dict[str, Any]:
        return dict(scene=self._scene, source_pos_m=source_pos_m, num_rays=self.options.num_rays, max_length_s=length_s,
                    rng=rng_for(self.options.seed, "trace", repr((self.room_id, tuple(source_pos_m)))))

    def render(self, source_pos_m: tuple[float, ...], mics_m: list[tuple[float, ...]], rir_ids: list[str],
               target_s: float | None, absorption: FloatArray, **how: Any) -> list[Response]:
        """Render the responses at some microphones with absorption of shape (n_surfaces, n_bands).

        It is scaled to a target, or taken as it is.

        They are as long as Eyring's decay, or longer where sound between reflecting surfaces decays more slowly: with a
        target up to `length_s`, without one as `longer_length_s` says.
        """
        followed_s: float = how.pop("length_s")
        how["absorption"] = expected = least = absorption
        if target_s is not None:
            exponent = eyring_exponent(self._scene, target_s, absorption)
            how["exponent"] = self._pilot(source_pos_m, target_s).exponent(absorption, target_s, exponent)
            expected = scaled_absorption(absorption, how["exponent"])
            # more absorption than expected is served, too little is not
            least = scaled_absorption(absorption, min(exponent, how["exponent"]))
        length_s = self.first_length_s(absorption, target_s, followed_s)
        while True:
            traced = self._trace(source_pos_m, length_s, least)
            responses = self._render(traced, mics_m, rir_ids, target_s, expected, length_s, how)
            if not any(response.is_cut for response in responses):
                return responses
            if length_s < followed_s:
                length_s = min(2.0 * length_s, followed_s)
                continue
            longer_s = longer_length_s(responses, followed_s) if target_s is None else None
            if longer_s is None:
                return responses
            length_s = followed_s = longer_s

    def _render(self, traced: TracedSource, mics_m: list[tuple[float, ...]], rir_ids: list[str],
                target_s: float | None, expected: FloatArray, length_s: float, how: dict[str, Any]) -> list[Response]:
        seed, ism_order = self.options.seed, self.options.ism_order
        samples = sample_paths(traced, np.array(mics_m), expected,
                               [rng_for(seed, "echoes", rir_id) for rir_id in rir_ids], ism_order=ism_order,
                               n_frames=int(np.ceil(length_s / FRAME_S)))
        how = how | dict(length_s=length_s, ism_order=ism_order, diffraction=self.options.diffraction,
                         path_samples=samples)
        rngs = [rng_for(seed, "tail", rir_id) for rir_id in rir_ids]
        try:
            if target_s is None:
                return render_responses(traced, mics_m, rngs, **how)
            return render_to_target(traced, mics_m, rngs, target_s, **how)
        except NotFiniteError as error:
            raise NotFiniteError(f"RIR {rir_ids[0]} of room {self.room_id}: {error}") from None


def _render_row(room: TracedRoom, member: Member, effects: list[Effect], draws: Iterable[SceneDraw]) -> RenderedRir:
    """Render one row with the first draw of materials and target that can be met."""
    row, place = member
    names, mics_m = map(list, zip(*channels_of(row, place), strict=True))
    problem, target_number = None, 0
    for draw in draws:
        if draw.target_number > target_number:  # this room, at this distance, cannot sound like that
            target_number = draw.target_number
            logger.info("%s: %s; drawing another target", row["id"], problem)
        try:
            responses = room.render(place.source_pos_m, mics_m, names, draw.target_s, draw.scene.absorption,
                                    length_s=draw.length_s, arrays=[0] * len(names),
                                    source_directivity=source_directivity(row, effects, room.options.fs_hz))
        except NotFiniteError:
            raise
        except ValueError as error:
            problem = error
            continue
        if target_number:
            place = replace(place, drawn=(*place.drawn, TARGET_AGAIN))
        return RenderedRir(row, place, draw.scene, responses[0], effects, draw.target_s, draw.length_s,
                           others=tuple(responses[1:]))
    raise ValueError(f"RIR {row['id']}: {problem}")


def _render_noises(room: TracedRoom, rendered: list[RenderedRir]) -> list[list[RenderedRir]]:
    """Render the noise sources of all rows, source by source; return for each row those of its noises."""
    noises = [[_noise_rir(rir, n, source_pos_m) for n, source_pos_m in enumerate(_noise_sources(rir, room), start=1)]
              for rir in rendered]
    responses: dict[str, list[Response]] = {}
    for source_pos_m in sorted({noise.place.source_pos_m for of_row in noises for noise in of_row}):
        of_source = [noise for of_row in noises for noise in of_row if noise.place.source_pos_m == source_pos_m]
        room.share_trace(source_pos_m, [(noise.response.absorption, None, noise.length_s) for noise in of_source])
        for noise in of_source:
            of_row = channels_of(noise.row, noise.place)
            responses[noise.row["id"]] = room.render(
                source_pos_m, [mic_m for _, mic_m in of_row], [name for name, _ in of_row], None,
                noise.response.absorption, length_s=noise.length_s, arrays=[0] * len(of_row))
    return [[replace(noise, response=responses[noise.row["id"]][0], others=tuple(responses[noise.row["id"]][1:]))
             for noise in of_row] for of_row in noises]


def channels_of(row: RirRow, place: Place) -> list[tuple[str, tuple[float, ...]]]:
    """Return name and position of each microphone of a row; the first, or only one, has the name of the row."""
    return [(row["id"] if n == 0 else f"{row['id']} {n}", position)
            for n, position in enumerate(place.channels_m or (place.mic_pos_m,))]


def _noise_rir(rir: RenderedRir, number: int, source_pos_m: tuple[float, ...]) -> RenderedRir:
    """Return an RIR moved to one of its noise sources; its response is still to be rendered."""
    row: RirRow = {**rir.row, "id": f"{rir.row['id']}-noise{number}", "source_dir": None, "source_directivity": None,
                   "source_id": f"noise-{source_pos_m[0]}-{source_pos_m[1]}-{source_pos_m[2]}"}
    return replace(rir, row=row, place=replace(rir.place, source_pos_m=source_pos_m), target_s=None,
                   effects=[effect for effect in rir.effects if effect.SCOPE not in ("source", "rir")],
                   noise_for=rir.row["id"])


def _noise_sources(rir: RenderedRir, room: TracedRoom) -> list[tuple[float, ...]]:
    """Return the first few of the room's noise positions that keep clear of the microphone and the source."""
    place, options = rir.place, room.options
    candidates = noise_positions(place.room, rir.row["room_id"], options.seed, 2 * NOISE_CANDIDATES)
    clearance_m = [min(np.linalg.norm(np.subtract(position, place.mic_pos_m)),
                       np.linalg.norm(np.subtract(position, place.source_pos_m))) for position in candidates]
    clear = [position for position, distance_m in zip(candidates, clearance_m, strict=True)
             if distance_m >= _NOISE_DISTANCE_M]
    if len(clear) < options.noise_rirs:
        clear = [candidates[n] for n in np.argsort(clearance_m)[::-1] if clearance_m[n] >= MIN_DISTANCE_M]
    return [tuple(position) for position in clear[:options.noise_rirs]]


def source_directivity(row: RirRow, effects: Sequence[Effect], fs_hz: int) -> Directivity | None:
    """Return the directivity of a row's source: that of the model, else the row's own, else none."""
    if (learned := path_gain(effects, row.get("source_dir"))) is not None:
        return learned
    own = row.get("source_directivity")
    if own is None:
        return None
    facing = np.array(row.get("source_dir"), dtype=float)
    gain: Callable[..., FloatArray] = Loudspeaker(facing, own["radius_m"], own["membrane_radius_m"]).pressure
    return partial(gain, fs_hz=fs_hz)
