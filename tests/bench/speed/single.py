"""One room: one response, 31 microphones, the same room as a mesh, furniture, new materials and targets."""

import numpy as np

from bench import ours, peer
from bench.kit import Check, Section
from bench.rooms import FURNISHED_M, box_triangles, furnished_triangles, l_triangles
from bench.speed.timing import repeated

ABSORPTION, SCATTERING = 0.1, 0.1
SOURCE = (2.137, 3.311, 1.523)
N_MICS = 31
BAND_SCATTERING = (0.1, 0.1, 0.1, 0.3, 0.3, 0.3, 0.3, 0.3)  # as in conf/materials.toml: two values


def microphones(count=N_MICS):
    """Positions that are free in the box and among the furniture."""
    rng = np.random.default_rng(8)
    mics = rng.uniform([0.7, 0.7, 1.1], [FURNISHED_M[0] - 0.7, FURNISHED_M[1] - 0.7, 2.2], (4 * count, 3))
    far = np.linalg.norm(mics - SOURCE, axis=1) > 1.0
    return mics[far][:count]


def scenes():
    """Scenes to time: {name: scene}."""
    air = ours.real_air()
    box = box_triangles(FURNISHED_M)
    return {"shoebox": ours.box_scene(FURNISHED_M, ABSORPTION, SCATTERING, air),
            "shoebox, two scattering values": ours.box_scene(FURNISHED_M, ABSORPTION, BAND_SCATTERING, air),
            "12-triangle mesh": ours.mesh_scene(box, ["wall"] * 12, ABSORPTION, SCATTERING, air),
            "L-shaped mesh (6x6x3 m)": ours.mesh_scene(*l_triangles(), ABSORPTION, SCATTERING, air),
            "furnished mesh": ours.mesh_scene(*furnished_triangles(), ABSORPTION, SCATTERING, air)}


def run(quick):
    """Ratios to pyroomacoustics' hybrid at equal rays and threads, in one run."""
    repeats = 1 if quick else 5
    mics = {1: microphones()[:1], N_MICS: microphones()}
    rows, seconds = [], {}
    for name, scene in scenes().items():
        source = (5.2, 1.1, 1.4) if name.startswith("L") else SOURCE
        for count, positions in mics.items():
            if name.startswith("L"):
                positions = np.random.default_rng(8).uniform([0.7, 0.7, 1.0], [2.3, 5.3, 2.0], (count, 3))
            median, spread, first = repeated(
                lambda n, scene=scene, source=source, positions=positions: ours.simulate(
                    scene, source, positions, seed=n), repeats if count == 1 else max(1, repeats // 2))
            seconds[name, count] = median
            rows.append([name, count, "roomeq", median, spread, first, None])
    if peer.load():
        _peer_rows(rows, seconds, mics, repeats)
        for row in rows:
            reference = seconds.get(("pyroomacoustics, 8 bands", row[1]))
            row[-1] = reference / row[3] if row[2] == "roomeq" else None
    section = Section("single", f"One source in {'x'.join(f'{x:g}' for x in FURNISHED_M)} m, alpha {ABSORPTION:g}, "
                      f"{ours.N_RAYS} rays, {ours.FS_HZ} Hz, air",
                      ["room", "microphones", "who", "median s", "+- s", "first call s", "times faster"], rows)
    section.notes = ["times faster: than pyroomacoustics' hybrid of the shoebox with the same microphones and 8 octave "
                     "bands; its 7 octaves and its single band (flat material, no air) are reported too",
                     "first call: includes compilation, or reading the compiled code from the cache"]
    if peer.load():
        section.checks = [
            Check("one response, times faster", _ratio(seconds, "shoebox", 1), low=6.0),
            Check(f"{N_MICS} microphones, times faster", _ratio(seconds, "shoebox", N_MICS), low=20.0),
            Check("12-triangle mesh, times faster", _ratio(seconds, "12-triangle mesh", 1), low=2.0),
            Check("furnished mesh, times faster", _ratio(seconds, "furnished mesh", 1), low=5.0),
            Check(f"furnished mesh, {N_MICS} microphones, times faster", _ratio(seconds, "furnished mesh", N_MICS),
                  low=10.0),
            Check("one response, times faster than its single band", _ratio(seconds, "shoebox", 1, "1 band")),
            Check(f"{N_MICS} microphones, times faster than its single band",
                  _ratio(seconds, "shoebox", N_MICS, "1 band"))]
    else:
        section.notes.append(peer.ABSENT)
    return section


def _ratio(seconds, name, count, bands="8 bands"):
    return seconds[f"pyroomacoustics, {bands}", count] / seconds[name, count]


def _peer_rows(rows, seconds, mics, repeats):
    for bands, air in ((8, True), (7, True), (1, False)):
        for count, positions in mics.items():
            parts = []

            def work(n, bands=bands, air=air, positions=positions, parts=parts):
                parts.append(peer.hybrid(FURNISHED_M, ABSORPTION, SCATTERING, SOURCE, positions, n_bands=bands, air=air,
                                         n_rays=ours.N_RAYS, seed=n + 1)[1])

            median, spread, first = repeated(work, max(1, repeats // 2 if count > 1 else repeats))
            name = f"pyroomacoustics, {bands} band{'s' if bands > 1 else ''}"
            seconds[name, count] = median
            split = {key: float(np.median([part[key] for part in parts[1:]])) for key in parts[0]}
            room = f"shoebox ({split['rays']:.2f} s rays, {split['render']:.2f} s rendering)"
            rows.append([room, count, name, median, spread, first, None])


def run_stages(quick):
    """Where the time goes, and what new materials cost on a traced room."""
    repeats = 1 if quick else 3
    rows, checks = [], []
    for name, scene in scenes().items():
        if name.startswith("L"):
            continue
        for count in (1, N_MICS):
            spent = ours.stages(scene, SOURCE, microphones()[:count], repeats=repeats)
            share = 100.0 * spent["new materials"] / spent["trace"]
            rows.append([name, count, *(1e3 * spent[key] for key in STAGES), share])
            if name == "shoebox":
                checks.append(Check(f"new materials, {count} microphone{'s' if count > 1 else ''}, share of the trace",
                                    share, high=5.0, unit="%"))
    return Section("stages", "Where the time goes, medians",
                   ["room", "microphones", *(f"{key}, ms" for key in STAGES), "new materials / trace, %"], rows, checks,
                   ["gather: echograms from all stored paths, for one set of materials; sample: what is done once "
                    "instead where materials are to change; new materials: echograms of all 8 bands from the sample",
                    "rendering: from new materials to responses, echograms included; target: responses that meet a "
                    "T30, from the sample"])


STAGES = ("trace", "gather", "sample", "new materials", "rendering", "target")


def draw(axis, section):
    """Seconds per room and microphones."""
    labels = [f"{row[2] if row[2] != 'roomeq' else row[0]}, {row[1]}" for row in section.rows]
    axis.barh(labels, [row[3] for row in section.rows])
    axis.invert_yaxis()
    axis.set(title="single: seconds", xscale="log", xlabel="s")
    axis.tick_params(axis="y", labelsize=6)
