"""A mesh of a room: its map, its volume, and the areas of its surfaces."""

from pathlib import Path

from roomeq.report.figures import panel
from roomeq.report.figures_room import VIEWS, room_view
from roomeq.report.room_map import outline
from roomeq.show.inputs import readable
from roomeq.show.pages import make_page
from roomeq.show.sheet import png
from roomeq.show.step import PICTURE
from roomeq.show.tables import as_text
from roomeq.sim.mesh import MeshRoom, load_mesh

SURFACE_COLUMNS = ("Surface", "Area (m2)", "Share (%)")
_ALT = {"plan": "Plan of the room", "section": "Section of the room"}


def show_room(path: Path, suffix: str | None) -> bytes | str:
    """Return the page, picture or text of a mesh file.

    Raises
    ------
    ValueError
        The file cannot be read, or the mesh is no closed room.
    """
    room, name = load_mesh(path), readable(path.name)
    if suffix is None:
        facts = as_text((name, ""), [[label, value] for value, label in _facts(room)])
        surfaces = as_text(SURFACE_COLUMNS, _surface_rows(room))
        return f"{facts}\n\n{surfaces}\n\nSee it: --out FILE.html or --out FILE.png."
    map_of_room = outline(room)
    if suffix == PICTURE:
        return png([room_view(map_of_room, view) for view in VIEWS], name)
    context = dict(maps=[panel(f"figure-{view}", room_view(map_of_room, view), _ALT[view]) for view in VIEWS],
                   surfaces=_surface_rows(room), n_triangles=len(room.triangles),
                   columns=[(heading, "text" if n == 0 else "number") for n, heading in enumerate(SURFACE_COLUMNS)])
    return make_page(name, "A room as the simulator sees it: its outline, its volume and its surfaces.", _facts(room),
                     [], [("mesh", "Room", context)])


def _facts(room: MeshRoom) -> list[tuple[str, str]]:
    """Return value and label of what is known of the whole room."""
    low_m, high_m = room.bounds_m
    size_m = " × ".join(f"{size:.2f}" for size in high_m - low_m)
    return [(f"{size_m} m", "box around the room"), (f"{room.volume_m3:.1f} m³", "volume"),
            (f"{room.surface_area_m2.sum():.1f} m²", "surface area"),
            (f"{4.0 * room.volume_m3 / room.surface_area_m2.sum():.2f} m", "mean free path, 4 V / S")]


def _surface_rows(room: MeshRoom) -> list[list[str]]:
    areas_m2 = room.surface_area_m2
    by_area = sorted(zip(areas_m2, room.surfaces, strict=True), reverse=True)
    return [[readable(surface), f"{area:.2f}", f"{100.0 * area / areas_m2.sum():.1f}"] for area, surface in by_area]
