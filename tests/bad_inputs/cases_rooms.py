"""Broken rooms: meshes and tables of materials."""

import json
import re

from right import BOX
from wrong import Case, row, write

MESH = "simulate --num-rays 100 mesh out"
MATERIALS = "simulate --num-rays 100 --materials own.toml measured out"
FELT = "[materials.felt]\nabsorption = {}\n"


def mesh(name: str, message: str, content: str | bytes) -> Case:
    return Case(name, MESH, message, (write("mesh/room.obj", content),))


def materials(name: str, message: str, content: str | bytes) -> Case:
    return Case(name, MATERIALS, message, (write("own.toml", content),))


def garbage(kind: str, message: str, content: bytes) -> Case:
    """A case whose mesh file is of another kind."""
    return Case(f"mesh {kind}", MESH, message, (write(f"mesh/room.{kind}", content),
                                                row("mesh/rirs.jsonl", 1, mesh=f"room.{kind}")))


CASES = [
    mesh("leaks",
         "RIR m1: mesh/room.obj: the mesh leaks: 4 edges don't join exactly two faces, the first near [0.0, "
         "0.0, 1.5] m: close the holes", BOX.removesuffix("f 4 1 5 8\n")),
    mesh("inside out",
         "RIR m1: mesh/room.obj: the mesh is inside out (its volume is -60 m3): turn its faces so that normals "
         "point out of the room", re.sub(r"f (.) (.) (.) (.)", r"f \4 \3 \2 \1", BOX)),
    mesh("inside out in parts",
         "RIR m1: mesh/room.obj: the mesh is inside out in parts: neighbouring faces turn opposite ways: make "
         "all normals point out of the room", BOX.replace("f 5 6 7 8", "f 8 7 6 5")),
    mesh("empty", "RIR m1: mesh/room.obj: holds no triangles: export it again", ""),
    mesh("no mesh", "RIR m1: mesh/room.obj: holds no triangles: export it again",
         b"\x80\x04\x95cos\nsystem\n(S'touch evil'\ntR."),
    mesh("vertices only", "RIR m1: mesh/room.obj: holds no triangles: export it again",
         "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
    mesh("vertex in a plane", "RIR m1: mesh/room.obj: cannot be read as a mesh (vertex 2 has 2 coordinates where three "
         "are needed): export it again", BOX.replace("v 5 0 0", "v 5 0")),
    mesh("vertex far away", "RIR m1: mesh/room.obj: cannot be read as a mesh (vertex 2 at [5e+30, 0.0, 0.0] must lie "
         "within 10000 m of the origin): export it again", BOX.replace("v 5 0 0", "v 5e30 0 0")),
    mesh("vertex a text", "RIR m1: mesh/room.obj: cannot be read as a mesh (...): export it again",
         "v a b c\n" + BOX),
    mesh("flat",
         "RIR m1: mesh/room.obj: the mesh leaks: 1 edges don't join exactly two faces, the first near [2.5, "
         "2.0, 0.0] m: close the holes", BOX.replace(" 3\nv", " 0\nv").replace("v 0 4 3", "v 0 4 0")),
    garbage("glb", "RIR m1: mesh/room.glb: holds no triangles: export it again",
         b"glTF\x02\0\0\0\xff\xff\xff\xff\xff\xff\xff\xffJSON{}"),
    garbage("stl", "RIR m1: mesh/room.stl: holds no triangles: export it again", b"\xff" * 200),
    garbage("ply", "RIR m1: mesh/room.ply: cannot be read as a mesh (...): export it again",
         b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n"),
    garbage("off", "RIR m1: mesh/room.off: cannot be read as a mesh (...): export it again",
         b"OFF\n99999999999 1 1\n0 0 0\n"),
    garbage("blend",
         "RIR m1: mesh/room.blend: a mesh must be one of .obj, .ply, .glb, .gltf, .stl, .off: export it as such",
         b""),
    materials("materials empty", "own.toml: no material with use 'wall': add one", ""),
    Case("model absent", "simulate --model absent.json measured out",
         "absent.json: No such file or directory: check the path"),
    Case("model a directory", "simulate --model rirs measured out", "rirs: Is a directory: check the path"),
    Case("model no JSON", "simulate --model m.json measured out", "m.json: ...", (write("m.json", "{"),)),
    Case("model of an unknown effect", "simulate --model m.json measured out",
         "m.json: effects[0]: effect='gnomes' must be one of ...",
         (write("m.json", '{"effects": [{"effect": "gnomes"}]}'),)),
    Case("model of text for numbers", "simulate --model m.json measured out",
         "m.json: effects[0]: typical=['far'] must be 1 numbers: correct them", (write("m.json", json.dumps(
             dict(effects=[dict(effect="sound_speed", of={}, typical=["far"])]))),)),
    Case("materials absent", "simulate --materials absent.toml measured out",
         "absent.toml: cannot be read as a table of materials (...): see conf/materials.toml for the form"),
    materials("materials no toml",
         "own.toml: cannot be read as a table of materials (...): see conf/materials.toml for the form",
         "absorption: 0.1"),
    materials("materials not utf-8",
         "own.toml: cannot be read as a table of materials (...): see conf/materials.toml for the form",
         b"[materials.caf\xe9]\n"),
    materials("absorption above 1",
         "own.toml: absorption[2]=1.3 of material 'felt' must lie in [0, 1]: correct the material",
         FELT.format("[0.1, 0.2, 1.3, 0.4, 0.5, 0.6, 0.7, 0.8]")),
    materials("absorption negative",
         "own.toml: absorption[0]=-0.1 of material 'felt' must lie in [0, 1]: correct the material",
         FELT.format("-0.1")),
    materials("absorption nan",
         "own.toml: absorption[0]=nan of material 'felt' must lie in [0, 1]: correct the material",
         FELT.format("nan")),
    materials("absorption of four bands",
         "own.toml: absorption of material 'felt': 4 coefficients must be 8 (62.5 Hz to 8 kHz), 7 (125 Hz to 8 "
         "kHz), 6 (125 Hz to 4 kHz) or 5 (125 Hz to 2 kHz): give one per band", FELT.format("[0.1, 0.1, 0.1, 0.1]")),
    materials("absorption a text",
         "own.toml: absorption='soft' of material 'felt' must be 8 numbers (62.5 Hz to 8 kHz) or one: correct "
         "the material", FELT.format("'soft'")),
    materials("absorption nested",
         "own.toml: absorption of material 'felt': 1 coefficients must be 8 (62.5 Hz to 8 kHz), 7 (125 Hz to 8 "
         "kHz), 6 (125 Hz to 4 kHz) or 5 (125 Hz to 2 kHz): give one per band", FELT.format("[[[0.1]]]")),
    materials("no absorption", "own.toml: key 'absorption' is missing", "[materials.felt]\nscattering = 0.1\n"),
    materials("scattering above 1",
         "own.toml: scattering[0]=1.5 of material 'rough' must lie in [0, 1]: correct the material",
         FELT.format("0.1") + "[scattering]\nrough = 1.5\n"),
    Case("materials a directory", "simulate --materials rirs measured out",
         "rirs: cannot be read as a table of materials (...): see conf/materials.toml for the form"),
]
