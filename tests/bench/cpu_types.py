#!/usr/bin/env python3
"""How far results move when another type of CPU computes them: the smallest recipe, with other code paths forced.

Usage: tests/bench/cpu_types.py [--only numpy,all] --out DIR
e.g.:  tests/bench/cpu_types.py --out exp/cpu_types

numpy, OpenBLAS, numba and the C library each choose their code by the CPU they find; scipy's FFT and libsndfile
do not let themselves be told. Each variant makes one of them (or all) take what an old x86-64 would; what comes out is
compared file by file with what this CPU makes by itself. Prints a table and writes cpu_types.json.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import soundfile

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / name) for name in ("pysrc", "tests", "tests/data")]

from recipe_run import OPTIONS  # noqa: E402

from roomeq.core.files import write_json  # noqa: E402

VARIANTS = dict(
    again={},
    numpy=dict(NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4 AVX512_ICL AVX512_SPR"),
    openblas_haswell=dict(OPENBLAS_CORETYPE="Haswell"),
    openblas_nehalem=dict(OPENBLAS_CORETYPE="Nehalem"),
    numba=dict(NUMBA_CPU_NAME="generic"),
    libm=dict(GLIBC_TUNABLES="glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX2,-AVX,-FMA,-FMA4"))
VARIANTS["all"] = {name: value for variant in ("numpy", "openblas_nehalem", "numba", "libm")
                   for name, value in VARIANTS[variant].items()}
KINDS = dict(speech=".rvb/", compensated="rirs.sim.EQ", simulated="rirs.sim", measured="rirs.real", mixture="exp/eq")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(VARIANTS), help=f"some of {', '.join(VARIANTS)}")
    parser.add_argument("--out", type=Path, required=True, help="where everything goes")
    given = parser.parse_args()
    out = given.out.resolve()
    recipe(out / "native", out / "corpora", {})
    found = {}
    for name in given.only.split(","):
        recipe(out / name, out / "corpora", VARIANTS[name])
        found[name] = compare(out / "native", out / name)
        print(table({name: found[name]}), flush=True)
    write_json(out / "cpu_types.json", found)


def recipe(where, corpora, variables):
    """Run the recipe to the augmented data, but for the report."""
    subprocess.run(["./run.sh", *OPTIONS, "--nj", "1", "--data", f"{where}/data", "--exp", f"{where}/exp", "--corpora",
                    str(corpora), "--stop-stage", "6"], cwd=PROJECT, env=os.environ | variables, check=True,
                   stdout=subprocess.DEVNULL)


def compare(native, other):
    """Return, by kind of output, how many files differ, and by how much at most."""
    found = {}
    for path in sorted(native.rglob("*")):
        name = str(path.relative_to(native))
        kind = next((kind for kind, part in KINDS.items() if part in name), None)
        if not path.is_file() or "/log/" in name or path.name.startswith(".") or kind is None:
            continue
        here = found.setdefault(kind, dict(files=0, different=0, audio_db=None, audio_lsb=0, numbers=None, words=0))
        here["files"] += 1
        first, second = path.read_bytes(), (other / name).read_bytes() if (other / name).is_file() else b""
        if first.replace(str(native).encode(), b"") == second.replace(str(other).encode(), b""):
            continue
        here["different"] += 1
        if path.suffix in (".wav", ".flac"):
            audio(path, other / name, here)
        elif path.suffix in (".json", ".jsonl"):
            numbers(first, second, here)
        else:
            here["words"] += 1
    return found


def audio(path, other, here):
    """Note power of the difference relative to the signal [dB] and the largest difference in steps of 16 bits."""
    x, y = soundfile.read(path)[0], soundfile.read(other)[0]
    if x.shape != y.shape:
        here["words"] += 1
        return
    level_db = 10 * np.log10(np.mean((x - y) ** 2) / np.mean(x**2)) if np.any(x != y) else -np.inf
    here["audio_db"] = max(round(float(level_db), 1), -999.0 if here["audio_db"] is None else here["audio_db"])
    here["audio_lsb"] = max(here["audio_lsb"], int(round(np.abs(x - y).max() * 32768)))


def numbers(first, second, here):
    """Note the largest relative difference of numbers, and count what is not a number and differs."""
    for a, b in zip(map(json.loads, documents(first)), map(json.loads, documents(second)), strict=True):
        for key, one, two in leaves(a, b):
            if isinstance(one, float | int) and isinstance(two, float | int) and not isinstance(one, bool):
                apart = abs(one - two) / max(abs(one), abs(two), 1e-300)
                if one != two and apart > (here["numbers"] or [0])[0]:
                    here["numbers"] = [float(f"{apart:.2g}"), key, one, two]
            elif one != two and not isinstance(one, str):
                here["words"] += 1


def documents(data):
    try:
        json.loads(data)
        return [data]
    except ValueError:
        return data.splitlines()


def leaves(a, b, key=""):
    """Yield key and both values of all that is in either of two documents."""
    if isinstance(a, dict) and isinstance(b, dict):
        for name in sorted(a.keys() | b.keys()):
            yield from leaves(a.get(name), b.get(name), f"{key}.{name}")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for one, two in zip(a, b, strict=True):
            yield from leaves(one, two, key)
    else:
        yield key, a, b


def table(found):
    lines = []
    for name, kinds in found.items():
        for kind, here in kinds.items():
            said = f"{here['different']} of {here['files']} files differ"
            if here["audio_db"] is not None:
                said += f"; audio at most {here['audio_db']} dB, {here['audio_lsb']} steps of 16 bits"
            if here["numbers"]:
                apart, key, one, two = here["numbers"]
                said += f"; numbers at most {apart:.1e} ({key}: {one} and {two})"
            if here["words"]:
                said += f"; otherwise: {here['words']}"
            lines.append(f"| {name} | {kind} | {said} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
