"""RIR directories of our own that refer to nothing outside them."""

from collections.abc import Mapping
from typing import Any

from roomeq.core.files import write_bytes
from roomeq.export.content import Content
from roomeq.records.rir_dir import write_noises, write_rirs
from roomeq.sim.mesh import load_mesh

MESHES = "meshes"
"""Folder of meshes."""


def write_manifests(content: Content) -> None:
    """Write `rirs.jsonl`, `rir_list` and `noises.jsonl`, and copy the meshes.

    Raises
    ------
    ValueError
        A mesh cannot be read alone.
    """
    rirs, noises = ([dict(made.planned.row or {}, wav=made.file) for made in content.audio
                     if made.planned.is_rir is wanted] for wanted in (True, False))
    if rirs:
        copied = _copy_meshes(content, rirs)
        write_rirs(content.work, [row | dict(mesh=copied[row["mesh"]]) if row.get("mesh") else row for row in rirs],
                   final_directory=content.out)
    if noises:
        write_noises(content.work, noises)


def _copy_meshes(content: Content, rirs: list[dict[str, Any]]) -> Mapping[str, str]:
    """Copy the meshes of rows; return the path of each copy by that of the mesh."""
    copied = {}
    for number, mesh in enumerate(sorted({row["mesh"] for row in rirs if row.get("mesh")}), start=1):
        source = content.source / mesh
        copied[mesh] = f"{MESHES}/{number}/{source.name}"
        write_bytes(content.work / copied[mesh], source.read_bytes())
        try:
            load_mesh(content.work / copied[mesh])
        except ValueError as error:
            raise ValueError(f"{source}: its copy cannot be read ({error}): put the mesh into one file, GLB or "
                             "OBJ") from None
    return copied
