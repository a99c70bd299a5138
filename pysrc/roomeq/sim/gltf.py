"""Room meshes in glTF 2.0 (GLB and glTF), checked before their arrays take memory.

`trimesh` makes the meshes. It gets the header and the bytes of the buffers and opens no file itself, so that textures
are never read. Sections in comments are those of the specification (Khronos Group, glTF 2.0).
"""

import base64
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

CheckBytes = Callable[[int], None]

MAX_NESTED_NODES = 100
"""Longest chain of nodes: the time for placing a node grows with the nodes above it."""

_HEADER, _BINARY = b"JSON", b"BIN\0"
# 3.6.2.2: bytes of a component, components of an element
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = dict(SCALAR=1, VEC2=2, VEC3=3, VEC4=4, MAT2=4, MAT3=9, MAT4=16)
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def load_gltf(path: Path, check_bytes: CheckBytes) -> Any:
    """Load a glTF file.

    Parameters
    ----------
    path
        GLB or glTF; buffers lie in the file, or in regular files below its folder.
    check_bytes
        Called with a number of bytes before so many are read or allocated; raises an error where they are too many.

    Returns
    -------
    trimesh.Scene

    Raises
    ------
    ValueError
        The header breaks a rule of glTF 2.0, or uses what is not read: sparse arrays, compression, deep nesting.
    """
    import trimesh

    header, binary = _split(path.read_bytes())
    version = str(header.get("asset", {}).get("version", "2.0"))
    if version.split(".")[0] != "2":
        raise ValueError(f"it is glTF {version:.20} and must be glTF 2.0")
    for name in _COMPRESSED:
        if name in header.get("extensionsRequired", []):
            raise ValueError(f"its arrays are compressed with {name}, which is not read")
    _check_nodes(header.get("nodes", []))
    check_bytes(_array_bytes(header))
    buffers = _read_buffers(header.get("buffers", []), binary, path.parent, check_bytes)
    for number, buffer in enumerate(header.get("buffers", [])):
        buffer["uri"] = str(number)
    for textures in ("images", "textures"):
        header.pop(textures, None)
    try:
        return trimesh.load(io.BytesIO(json.dumps(header).encode()), file_type="gltf", resolver=buffers, force="scene",
                            process=False)
    except AssertionError:  # how trimesh checks offsets, lengths and strides
        raise ValueError("its arrays do not fit into its buffers") from None


def _split(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """Return the header and the binary chunk, which a glTF file has not (4.4)."""
    binary = None
    if data[:4] == b"glTF":
        version = int.from_bytes(data[4:8], "little")
        if version != 2:
            raise ValueError(f"it is GLB of version {version} and must be of version 2, glTF 2.0")
        chunks: dict[bytes, bytes] = {}
        start = 12
        while start + 8 <= len(data):
            stop = start + 8 + int.from_bytes(data[start:start + 4], "little")
            if stop > len(data):
                raise ValueError(f"truncated: {len(data)} bytes of {stop}")
            chunks.setdefault(data[start + 4:start + 8], data[start + 8:stop])
            start = stop
        data, binary = chunks.get(_HEADER, b""), chunks.get(_BINARY)
    try:
        header = json.loads(data.decode("utf-8-sig"))
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None
    if not isinstance(header, dict):
        raise ValueError(f"its header is {str(header)[:20]!r} and must be a JSON object")
    return header, binary


def _check_nodes(nodes: list[dict[str, Any]]) -> None:
    """Refuse nodes below one another without end; `level` holds those that have so many nodes above them."""
    level = set(range(len(nodes)))
    for _ in range(MAX_NESTED_NODES):
        level = {child for n in level for child in nodes[n].get("children", ())}
        if not level:
            return
    if level:
        raise ValueError(f"its nodes are nested in a circle, or deeper than {MAX_NESTED_NODES}")


def _array_bytes(header: Mapping[str, Any]) -> int:
    """Return the bytes that the arrays of a header take: once each, in buffer views, or in the meshes they are for."""
    arrays = [_accessor_bytes(f"accessors[{n}]", one) for n, one in enumerate(header.get("accessors", []))]
    views = [_whole(f"bufferViews[{n}]", "byteLength", view.get("byteLength"))
             for n, view in enumerate(header.get("bufferViews", []))]
    used = [arrays[number] for mesh in header.get("meshes", []) for primitive in mesh["primitives"]
            for number in [*primitive["attributes"].values(), primitive.get("indices")] if number is not None]
    return max(sum(arrays), sum(views), sum(used))


def _accessor_bytes(place: str, accessor: Mapping[str, Any]) -> int:
    if "sparse" in accessor:
        raise ValueError(f"{place} is sparse, which is not read")
    for key, known in (("componentType", _COMPONENT_BYTES), ("type", _COMPONENTS)):
        if accessor.get(key) not in known:
            raise ValueError(f"{place}: {key}={accessor.get(key)!r:.40} must be one of {', '.join(map(str, known))}")
    count = _whole(place, "count", accessor.get("count"))
    return count * _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]


def _whole(place: str, key: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ValueError(f"{place}: {key}={value!r:.40} must be a positive whole number")
    return value


def _read_buffers(buffers: list[dict[str, Any]], binary: bytes | None, folder: Path,
                  check_bytes: CheckBytes) -> dict[str, bytes]:
    """Return the content of the buffers by their number, as text."""
    files = [_buffer_file(f"buffers[{n}]", buffer.get("uri"), folder) for n, buffer in enumerate(buffers)]
    check_bytes(sum(file.stat().st_size for file in files if file))
    return {str(n): file.read_bytes() if file else _embedded(f"buffers[{n}]", buffer.get("uri"), binary)
            for n, (buffer, file) in enumerate(zip(buffers, files, strict=True))}


def _buffer_file(place: str, uri: Any, folder: Path) -> Path | None:
    """Return the file of a buffer; None where its bytes are in the mesh file."""
    if uri is None or str(uri)[:5].lower() == "data:":
        return None
    named = folder / str(uri)
    path = named if named.is_file() else folder / unquote(str(uri))
    if not path.is_file():
        raise ValueError(f"{place}: uri={uri!r:.80} must name a regular file beside it")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{place}: uri={uri!r:.80} must lie in the folder of the mesh file")
    return path


def _embedded(place: str, uri: str | None, binary: bytes | None) -> bytes:
    if uri is None:
        if binary is None:
            raise ValueError(f"{place} has no uri, and the file no binary chunk")
        return binary
    media, comma, text = uri.partition(",")
    if not comma or not media.endswith(";base64"):
        raise ValueError(f"{place}: uri={uri!r:.40} must be in base64")
    return base64.b64decode(unquote(text))
