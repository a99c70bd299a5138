"""Render a drawn room: one set of materials for all its sources and microphones, scaled to its reverberation time."""

import logging
from collections.abc import Iterator, Sequence

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for
from roomeq.draw_rooms.draw import DrawnMic, DrawnRoom, DrawnSource
from roomeq.draw_rooms.room_types import DIRECTIVITIES, RoomType
from roomeq.effects.base import Effect
from roomeq.effects.model import Model
from roomeq.records.schema import Membrane, RirRow
from roomeq.sim.context import NotFiniteError, Response
from roomeq.sim.geometry import Place
from roomeq.sim.materials import MaterialTable, Surface, find_surface
from roomeq.sim.response import needed_length_s
from roomeq.sim.room import Room
from roomeq.simulate_rirs.options import RenderOptions
from roomeq.simulate_rirs.source import (
    MATERIAL_DRAWS,
    TARGET_DRAWS,
    Member,
    RenderedRir,
    SceneDraw,
    TracedRoom,
    channels_of,
    source_directivity,
    with_noises,
)

logger = logging.getLogger(__name__)

MESHES = "meshes"
"""Folder of the meshes of drawn rooms, in their RIR directory."""


def table_of_type(table: MaterialTable, room_type: RoomType, where: str) -> MaterialTable:
    """Return the table of materials with those alone in use that a type of rooms names.

    Raises
    ------
    ValueError
        A material is in no table; the message begins with `where`.
    """
    absorption, own, uses = dict(table.absorption), dict(table.own_scattering), dict(table.uses)
    for use, key in (("wall", "walls"), ("floor", "floors"), ("ceiling", "ceilings")):
        names: Sequence[str] = getattr(room_type, key)
        for name in names:
            surface = _find(table, name, f"{where}: {room_type.name}: {key}")
            absorption[name] = surface.absorption
            if surface.scattering is not None:
                own[name] = surface.scattering
        if names:
            uses = {name: tuple(known for known in uses.get(name, ()) if known != use)
                    + ((use,) if name in names else ()) for name in absorption}
    for n, furniture in enumerate(room_type.furniture):
        for name in furniture.materials:
            _find(table, name, f"{where}: {room_type.name}: furniture[{n}]: materials")
    return MaterialTable(absorption, uses, table.scattering, own)


def _find(table: MaterialTable, name: str, where: str) -> Surface:
    try:
        return find_surface(table, name)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def render_drawn_room(drawn: DrawnRoom, table: MaterialTable, model: Model,
                      options: RenderOptions) -> list[RenderedRir]:
    """Render the responses from each source of a drawn room to each microphone.

    The materials are scaled for the first source, in the mean over the microphones, and are then those of the room.

    Parameters
    ----------
    table
        Of the room's type (`table_of_type`).
    options
        Where it has a range of T60, times are uniform in it, whatever the room's type says.

    Returns
    -------
    list of RenderedRir
        For each source and microphone its response, followed by those of its noise sources.

    Raises
    ------
    ValueError
        No reverberation time that was drawn can be met, or a response is not finite; the message names the room.
    """
    shape = drawn.shape.room()
    members = [[Member(_row(drawn, source, mic), _place(shape, source, mic)) for mic in drawn.mics]
               for source in drawn.sources]
    effects = [[model.for_row(member.row, options.seed) for member in of_source] for of_source in members]
    stated = _furniture_surfaces(drawn, table, shape, options.seed)
    room = TracedRoom(shape, drawn.id, stated, drawn.air, table, effects[0][0], options)
    rendered: list[RenderedRir] = []
    problem: ValueError | None = None
    for draw in _draw_scenes(room, drawn):
        try:
            rendered = _render_source(room, members[0], effects[0], draw, draw.target_s)
            break
        except NotFiniteError:
            raise
        except ValueError as error:
            problem = error
    if not rendered:
        raise ValueError(f"{drawn.id} of type {drawn.room_type.name!r}: {problem}")
    for of_source, their_effects in zip(members[1:], effects[1:], strict=True):
        rendered += _render_source(room, of_source, their_effects, draw, None, rendered[0].response.absorption)
    return with_noises(room, rendered)


def _row(drawn: DrawnRoom, source: DrawnSource, mic: DrawnMic) -> RirRow:
    membrane = DIRECTIVITIES[source.directivity]
    # a loudspeaker or microphone of its own for each room: a model draws their responses by these ids
    row: RirRow = {"id": f"{drawn.id}-{source.id}-{mic.id}", "wav": "", "room_id": drawn.id,
                   "source_id": f"{drawn.id}-{source.id}", "mic_id": f"{drawn.id}-{mic.id}",
                   "room_type": drawn.room_type.name,
                   "source_dir": None if source.facing is None else list(source.facing),
                   "source_directivity": None if membrane is None else Membrane(
                       radius_m=membrane.radius_m, membrane_radius_m=membrane.membrane_radius_m)}
    if not drawn.shape.is_shoebox:
        row["mesh"] = f"{MESHES}/{drawn.id}.obj"
    if len(mic.channels_m) > 1:
        row["channel_pos_m"] = [list(position) for position in mic.channels_m]
    return row


def _place(room: Room, source: DrawnSource, mic: DrawnMic) -> Place:
    return Place(room, source.position_m, mic.channels_m[0], (), mic.channels_m if len(mic.channels_m) > 1 else ())


def _furniture_surfaces(drawn: DrawnRoom, table: MaterialTable, room: Room, seed: int) -> dict[str, Surface]:
    """Draw the material of each kind of furniture."""
    rng = rng_for(seed, "drawn furniture", drawn.id)
    surfaces = {}
    for number, furniture in enumerate(drawn.room_type.furniture, start=1):
        name = furniture.materials[rng.integers(len(furniture.materials))]
        if f"furniture{number}" in room.surfaces:
            surfaces[f"furniture{number}"] = find_surface(table, name)
    return surfaces


def _draw_scenes(room: TracedRoom, drawn: DrawnRoom) -> Iterator[SceneDraw]:
    """Yield materials and reverberation times to try: several draws of materials for each of several times."""
    rng = rng_for(room.options.seed, "drawn materials", drawn.id)
    for n in range(MATERIAL_DRAWS * TARGET_DRAWS):
        if n % MATERIAL_DRAWS == 0:
            target_s = (drawn.room_type.t60_s.draw(room.room.volume_m3, rng) if room.options.t60_range_s is None
                        else float(rng.uniform(*room.options.t60_range_s)))
        scene = room.draw_scene(target_s, rng)
        yield SceneDraw(scene, target_s, needed_length_s(scene, target_s, room.options.order), n // MATERIAL_DRAWS)


def _render_source(room: TracedRoom, members: list[Member], effects: list[list[Effect]], draw: SceneDraw,
                   target_s: float | None, absorption: FloatArray | None = None) -> list[RenderedRir]:
    """Render the responses of one source at all microphones, scaled to a target or with known absorption."""
    source_pos_m = members[0].place.source_pos_m
    channels = [channel for member in members for channel in channels_of(member.row, member.place)]
    names, mics_m = [name for name, _ in channels], [position for _, position in channels]
    responses = iter(room.render(
        source_pos_m, mics_m, names, target_s, draw.scene.absorption if absorption is None else absorption,
        length_s=draw.length_s,
        arrays=[n for n, member in enumerate(members) for _ in member.place.channels_m or (None,)],
        source_directivity=source_directivity(members[0].row, effects[0], room.options.fs_hz)))
    rendered = []
    for member, of_row in zip(members, effects, strict=True):
        of_channels: list[Response] = [next(responses) for _ in member.place.channels_m or (None,)]
        rendered.append(RenderedRir(member.row, member.place, draw.scene, of_channels[0], of_row, draw.target_s,
                                    draw.length_s, others=tuple(of_channels[1:])))
    return rendered
