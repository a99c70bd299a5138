"""Broken rooms: meshes and tables of materials."""

import base64
import json
import re
import struct

from right import BOX
from wrong import Case, row, write

MESH = "simulate --num-rays 100 mesh out"
MATERIALS = "simulate --num-rays 100 --materials own.toml measured out"
TOO_LARGE = "bytes must be at most 64000000 (64 MB): use fewer triangles, or raise the bound with roomeq --max-mesh-mb"
FELT = "[materials.felt]\nabsorption = {}\n"


def mesh(name: str, message: str, content: str | bytes) -> Case:
    return Case(name, MESH, message, (write("mesh/room.obj", content),))


def materials(name: str, message: str, content: str | bytes) -> Case:
    return Case(name, MATERIALS, message, (write("own.toml", content),))


def model(name: str, effect: str, message: str, **changed) -> Case:
    """A case whose model has one effect."""
    return Case(f"model {name}", "simulate --model m.json measured out", f"m.json: effects[0]: {message}",
                (write("m.json", json.dumps(dict(format=3, effects=[dict(effect=effect, of={}) | changed]))),))


def garbage(kind: str, message: str, content: bytes, how: str = "garbage") -> Case:
    """A case whose mesh file is of another kind."""
    return Case(f"mesh {kind} {how}", MESH, message, (write(f"mesh/room.{kind}", content),
                                                row("mesh/rirs.jsonl", 1, mesh=f"room.{kind}")))


def glb(header: dict) -> bytes:
    """The least that is a GLB file."""
    text = json.dumps(header).encode()
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text


def scaled(factor: float, offset: float = 0.0) -> str:
    """The box in another unit, or elsewhere."""
    lines = [line.split() for line in BOX.splitlines()]
    return "".join(" ".join([key, *(str(float(x) * factor + offset) for x in words)] if key == "v" else [key, *words])
                   + "\n" for key, *words in lines)


def gltf(how: str, message: str, **changed) -> Case:
    """A case whose glTF file differs in a few keys from a right one."""
    return garbage("gltf", f"RIR m1: mesh/room.gltf: cannot be read as a mesh ({message}): export it again",
                   json.dumps(many_times(1, 1) | changed).encode(), how)


def many_times(n_nodes: int, n_faces: int) -> dict:
    """The header of a glTF file with one mesh, at many places."""
    corners, faces = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0), struct.pack("<3H", 0, 1, 2) * n_faces
    places = [dict(buffer=0, byteOffset=0, byteLength=len(corners)),
              dict(buffer=0, byteOffset=len(corners), byteLength=len(faces))]
    return dict(
        asset=dict(version="2.0"), scene=0, scenes=[dict(nodes=list(range(n_nodes)))], nodes=[dict(mesh=0)] * n_nodes,
        meshes=[dict(primitives=[dict(attributes=dict(POSITION=0), indices=1)])],
        accessors=[dict(bufferView=0, count=3, componentType=5126, type="VEC3"),
                   dict(bufferView=1, count=3 * n_faces, componentType=5123, type="SCALAR")],
        bufferViews=places, buffers=[dict(byteLength=len(corners + faces), uri="data:application/octet-stream;base64,"
                                          + base64.b64encode(corners + faces).decode())])


CASES = [
    mesh("with a hole",
         "RIR m1: mesh/room.obj: the mesh has holes: 4 edges don't join exactly two faces, the first near [0.0, "
         "0.0, 1.5] m: close the holes, and give faces that meet along an edge the same corners on it",
         BOX.removesuffix("f 4 1 5 8\n")),
    mesh("normals into the room",
         "RIR m1: mesh/room.obj: the normals of the mesh point into the room (its volume is -60 m3): turn its faces so "
         "that normals point out of the room", re.sub(r"f (.) (.) (.) (.)", r"f \4 \3 \2 \1", BOX)),
    mesh("some normals into the room",
         "RIR m1: mesh/room.obj: neighbouring faces of the mesh have opposite normals: make all normals point out of "
         "the room", BOX.replace("f 5 6 7 8", "f 8 7 6 5")),
    mesh("empty", "RIR m1: mesh/room.obj: holds no triangles: export it again", ""),
    mesh("no mesh", "RIR m1: mesh/room.obj: holds no triangles: export it again",
         b"\x80\x04\x95cos\nsystem\n(S'touch evil'\ntR."),
    mesh("vertices only", "RIR m1: mesh/room.obj: holds no triangles: export it again",
         "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
    mesh("vertex in a plane", "RIR m1: mesh/room.obj: cannot be read as a mesh (vertex 2 has 2 coordinates where three "
         "are needed): export it again", BOX.replace("v 5 0 0", "v 5 0")),
    mesh("vertex far away", "RIR m1: mesh/room.obj: the room is 5e+30 m long and must be 0.1 m to 200 m: is it in "
         "millimetres? Export it in metres", BOX.replace("v 5 0 0", "v 5e30 0 0")),
    mesh("vertex nan", "RIR m1: mesh/room.obj: every vertex must be a finite number of metres: export it again",
         BOX.replace("v 5 0 0", "v nan 0 0")),
    mesh("in millimetres", "RIR m1: mesh/room.obj: the room is 6,000 m long and must be 0.1 m to 200 m: is it in "
         "millimetres? Export it in metres", scaled(1200)),
    mesh("in centimetres", "RIR m1: mesh/room.obj: the room is 500 m long and must be 0.1 m to 200 m: is it in "
         "inches or centimetres? Export it in metres", scaled(100)),
    mesh("in inches", "RIR m1: mesh/room.obj: the room is 200.2 m long and must be 0.1 m to 200 m: is it in "
         "inches or centimetres? Export it in metres", scaled(40.04)),
    mesh("in kilometres", "RIR m1: mesh/room.obj: the room is 0.005 m long and must be 0.1 m to 200 m: is it in "
         "kilometres? Export it in metres", scaled(1e-3)),
    mesh("of denormals", "RIR m1: mesh/room.obj: the room is 5e-310 m long and must be 0.1 m to 200 m: is it in "
         "kilometres? Export it in metres", scaled(1e-310)),
    mesh("far from the origin", "RIR m1: mesh/room.obj: every vertex must lie within 10000 m of the origin: move the "
         "room there", scaled(1, 1e6)),
    mesh("vertex a text", "RIR m1: mesh/room.obj: cannot be read as a mesh (...): export it again",
         "v a b c\n" + BOX),
    mesh("flat",
         "RIR m1: mesh/room.obj: more than two faces of the mesh meet in 1 edges, the first near [2.5, 2.0, 0.0] m: "
         "move bodies that touch 1 mm apart or join them, and give walls a thickness",
         BOX.replace(" 3\nv", " 0\nv").replace("v 0 4 3", "v 0 4 0")),
    mesh("face of many corners",
         "RIR m1: mesh/room.obj: cannot be read as a mesh (a face of 501 corners; at most 500 are cut into "
         "triangles): export it again", BOX + "f" + " 1" * 501 + "\n"),
    Case("mesh beyond the bound", f"--max-mesh-mb 0.0001 {MESH}",
         "RIR m1: mesh/room.obj: 142 bytes must be at most 100 (0.0001 MB): use fewer triangles, or raise the bound "
         "with roomeq --max-mesh-mb"),
    Case("mesh beyond the bound beside it", MESH, f"RIR m1: mesh/room.gltf: 64000001 {TOO_LARGE}",
         (write("mesh/room.gltf", json.dumps(dict(buffers=[dict(uri="zeros.bin", byteLength=1)]))),
          write("mesh/zeros.bin", bytes(64_000_001)), row("mesh/rirs.jsonl", 1, mesh="room.gltf"))),
    garbage("glb", "RIR m1: mesh/room.glb: cannot be read as a mesh (truncated: 22 bytes of 4294967315): export it "
            "again", b"glTF\x02\0\0\0\xff\xff\xff\xff\xff\xff\xff\xffJSON{}"),
    garbage("glb", f"RIR m1: mesh/room.glb: 12000000000 {TOO_LARGE}",
            glb(dict(accessors=[dict(count=10**9, componentType=5126, type="VEC3")])), "without bytes"),
    garbage("gltf", "RIR m1: mesh/room.gltf: cannot be read as a mesh (accessors[0]: type='VEC9' must be one of "
            "SCALAR, VEC2, VEC3, VEC4, MAT2, MAT3, MAT4): export it again",
            json.dumps(dict(accessors=[dict(count=1, componentType=5126, type="VEC9")])).encode(), "of no type"),
    garbage("gltf", f"RIR m1: mesh/room.gltf: 72000000 {TOO_LARGE}",
            json.dumps(many_times(100, 10_000)).encode(), "of one mesh many times"),
    gltf("of a negative count", "accessors[0]: count=-1 must be a positive whole number",
         accessors=[dict(count=-1, componentType=5126, type="VEC3")]),
    gltf("whose counts cancel", "accessors[1]: count=-1000000000 must be a positive whole number", accessors=[
        dict(count=count, componentType=5126, type="VEC3") for count in (10**9, -10**9)]),
    gltf("whose views are negative", "bufferViews[0]: byteLength=-4 must be a positive whole number",
         bufferViews=[dict(buffer=0, byteLength=-4)]),
    gltf("whose arrays lie elsewhere", "its arrays do not fit into its buffers",
         bufferViews=[dict(buffer=0, byteOffset=-10, byteLength=36), dict(buffer=0, byteLength=6)]),
    gltf("of sparse arrays", "accessors[0] is sparse, which is not read",
         accessors=[dict(count=3, componentType=5126, type="VEC3", sparse={})]),
    gltf("1.0", "it is glTF 1.0 and must be glTF 2.0", asset=dict(version="1.0"), accessors={}),
    gltf("compressed", "its arrays are compressed with KHR_draco_mesh_compression, which is not read",
         extensionsRequired=["KHR_draco_mesh_compression"]),
    gltf("of nodes in a circle", "its nodes are nested in a circle, or deeper than 100",
         nodes=[dict(mesh=0, children=[0])]),
    gltf("of deep nodes", "its nodes are nested in a circle, or deeper than 100",
         nodes=[dict(children=[n + 1]) for n in range(5000)] + [dict(mesh=0)]),
    gltf("of a device", "buffers[0]: uri='/dev/zero' must name a regular file beside it",
         buffers=[dict(uri="/dev/zero", byteLength=42)]),
    garbage("gltf", "RIR m1: mesh/room.gltf: cannot be read as a mesh (its JSON is nested too deeply): export it "
            "again", b"[" * 10**5 + b"]" * 10**5, "of deep JSON"),
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
         (write("m.json", '{"format": 3, "effects": [{"effect": "gnomes"}]}'),)),
    Case("model of text for numbers", "simulate --model m.json measured out",
         "m.json: effects[0]: typical=['far'] must be 1 numbers: correct them", (write("m.json", json.dumps(
             dict(format=3, effects=[dict(effect="sound_speed", of={}, typical=["far"])]))),)),
    model("of a misspelt key", "sound_speed", "key 'spred' must be one of effect, of, typical, spread: correct or "
          "remove it", spred=[1]),
    Case("model of a misspelt list", "simulate --model m.json measured out", "m.json: key 'efects' must be one of "
         "format, effects, facings, heights_m: correct or remove it",
         (write("m.json", '{"format": 3, "effects": [], "efects": []}'),)),
    Case("model of a parameter twice", "simulate --model m.json measured out", "m.json: not a JSON file (key "
         "'temperature_c' occurs twice: leave one out): make it again", (write("m.json", '{"format": 3, "effects": [{'
         '"effect": "sound_speed", "of": {"all": {"temperature_c": 20, "temperature_c": 30}}}]}'),)),
    model("of a room where all is meant", "sound_speed", "of['hall0'] must be of['all'], since sound_speed is of all "
          "RIRs: correct the name", of=dict(hall0=dict(temperature_c=20))),
    model("typical of 1000", "sound_speed", "typical=[1000] must lie in [-100, 100]: correct them", typical=[1000]),
    model("spread negative", "sound_speed", "spread=[-1] must lie in [0, 100]: correct them", spread=[-1]),
    model("without units", "sound_speed", "of=None must map each all to its parameters: add them", of=None),
    model("of other parameters", "sound_speed", "of['all'] must hold temperature_c: correct the names",
          of=dict(all=dict(warmth=3))),
    model("colder than cold", "sound_speed", "of['all']: temperature_c=-400 must lie in [-20, 60]: correct it",
          of=dict(all=dict(temperature_c=-400))),
    model("of modes without end", "room_modes", "of['all']: up_to_hz=1000000000.0 must lie in [40, 300]: correct it",
          of=dict(all=dict(up_to_hz=1e9))),
    model("of a desk above", "near_reflector", "of['hall0']: depth_m=-0.5 must lie in [0.05, 2]: correct it",
          of=dict(hall0=dict(depth_m=-0.5, reflection=0.5))),
    model("of a decay of no time", "coupled_volume", "of['hall0']: time_s=0 must lie in [0.2, 6]: correct it",
          of=dict(hall0=dict(level_db=-10, time_s=0, slope=0))),
    model("of 1000 dB", "room_eq", "of['all']: gains_db=[...1000...] must lie in [-60, 60]: correct it",
          of=dict(all=dict(gains_db=[0] * 25 + [1000]))),
    model("of three octaves", "noise_floor", "of['hall0']: levels_db=[-50, -50, -50] must be 22 numbers: correct it",
          of=dict(hall0=dict(levels_db=[-50] * 3))),
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
         "own.toml: absorption of material 'felt': 4 coefficients must be 9 (62.5 Hz to 16 kHz), 8 (to 8 "
         "kHz), 7 (125 Hz to 8 kHz), 6 (125 Hz to 4 kHz) or 5 (125 Hz to 2 kHz): give one per band",
         FELT.format("[0.1, 0.1, 0.1, 0.1]")),
    materials("absorption a text",
         "own.toml: absorption='soft' of material 'felt' must be 8 numbers (62.5 Hz to 8 kHz), 9 (to 16 "
         "kHz) or one: correct the material", FELT.format("'soft'")),
    materials("absorption nested",
         "own.toml: absorption of material 'felt': 1 coefficients must be 9 (62.5 Hz to 16 kHz), 8 (to 8 "
         "kHz), 7 (125 Hz to 8 kHz), 6 (125 Hz to 4 kHz) or 5 (125 Hz to 2 kHz): give one per band",
         FELT.format("[[[0.1]]]")),
    materials("no absorption", "own.toml: key 'absorption' is missing", "[materials.felt]\nscattering = 0.1\n"),
    materials("scattering above 1",
         "own.toml: scattering[0]=1.5 of material 'rough' must lie in [0, 1]: correct the material",
         FELT.format("0.1") + "[scattering]\nrough = 1.5\n"),
    Case("materials a directory", "simulate --materials rirs measured out",
         "rirs: cannot be read as a table of materials (...): see conf/materials.toml for the form"),
]
