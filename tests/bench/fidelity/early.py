"""The early part: specular paths, in lists and as rendered, against image sources computed elsewhere."""

import numpy as np

from bench import ours, peer
from bench.fidelity.pulses import fit_pulses
from bench.fidelity.reference import SPEED_M_S
from bench.kit import Check, Section

ORDER = 6
ROOMS = (  # dimensions, absorption of the six walls, source, microphone
    ((6.0, 4.0, 3.0), (0.1, 0.3, 0.2, 0.5, 0.05, 0.6), (1.713, 1.341, 1.627), (4.429, 2.917, 1.203)),
    ((12.0, 8.0, 4.0), (0.3,) * 6, (2.137, 3.311, 1.523), (8.719, 5.243, 1.907)),
    ((20.0, 10.0, 5.0), (0.2, 0.2, 0.4, 0.4, 0.1, 0.7), (4.327, 6.141, 1.613), (15.233, 2.719, 1.129)),
)


def run(quick):
    """Arrival within 0.1 sample and level within 0.2 dB per path."""
    rows, worst = [], {"arrival": [], "level": [], "rendered arrival": [], "rendered level": []}
    for dims_m, absorption, source, mic in ROOMS[:1] if quick else ROOMS:
        length_m, gain = image_sources(dims_m, absorption, source, mic, ORDER)
        found = {"roomeq list": ours.specular_list(dims_m, absorption, source, mic, ORDER)}
        if peer.load():
            found["pyroomacoustics list"] = peer.image_paths(dims_m, absorption, source, mic, order=ORDER)
        for who, (other_m, other_gain) in found.items():
            arrival, level = _differences(length_m, gain, other_m, other_gain)
            rows.append([_name(dims_m), who, len(other_m), len(length_m), arrival, level])
            if who == "roomeq list":
                worst["arrival"].append(arrival)
                worst["level"].append(level)
        for who, rir, lag, cut_hz in _rendered(dims_m, absorption, source, mic):
            arrival, level, count = _fitted(rir, length_m, lag, gain, dims_m, cut_hz)
            rows.append([_name(dims_m), who, count, count, arrival, level])
            if who == "roomeq rendered":
                worst["rendered arrival"].append(arrival)
                worst["rendered level"].append(level)
    checks = [Check(f"{what}, worst path", float(np.max(values)), high=0.2 if "level" in what else 0.1,
                    unit="dB" if "level" in what else "samples") for what, values in worst.items()]
    notes = ["against Allen and Berkley's image sources, computed here; rendered: all paths before the first of "
             f"order {ORDER + 1} that stand 2.5 samples apart, fitted below 6.4 kHz; ours cut reflections off below "
             f"{ours.REFLECTIONS_FROM_HZ:g} Hz, which is expected of them"]
    if not peer.load():
        notes.append(peer.ABSENT)
    return Section("early", f"Specular paths up to order {ORDER}, scattering 0",
                   ["room", "who", "paths", "expected", "arrival, samples", "level, dB"], rows, checks, notes)


def image_sources(dims_m, absorption, source, mic, order):
    """Image sources of a shoebox (Allen and Berkley 1979, eq. 5 to 10), sorted by length.

    Returns
    -------
    length_m, gain : ndarray, shape (n_paths,)
        The gain is a pressure; 1 / (4 pi r) times the root of ``1 - alpha`` of every reflection.
    """
    length_m, gain = [], []
    span = range(-order, order + 1)
    for mirrored in np.ndindex(2, 2, 2):
        for cell in ((x, y, z) for x in span for y in span for z in span):
            low = [abs(n - p) for n, p in zip(cell, mirrored, strict=True)]
            high = [abs(n) for n in cell]
            if sum(low) + sum(high) > order:
                continue
            image = [(1 - 2 * p) * x + 2 * n * size
                     for p, x, n, size in zip(mirrored, source, cell, dims_m, strict=True)]
            kept = np.prod([(1.0 - absorption[2 * a]) ** low[a] * (1.0 - absorption[2 * a + 1]) ** high[a]
                            for a in range(3)])
            length_m.append(np.linalg.norm(np.subtract(image, mic)))
            gain.append(np.sqrt(kept) / (4.0 * np.pi * length_m[-1]))
    by_length = np.argsort(length_m, kind="stable")
    return np.array(length_m)[by_length], np.array(gain)[by_length]


def _differences(length_m, gain, other_m, other_gain):
    if len(length_m) != len(other_m):
        return float("inf"), float("inf")
    arrival = np.max(np.abs(length_m - other_m)) / SPEED_M_S * ours.FS_HZ
    return float(arrival), float(np.max(np.abs(20.0 * np.log10(other_gain / gain))))


def _rendered(dims_m, absorption, source, mic):
    """Responses, with the lag of each [samples], and the frequency below which its reflections are cut off."""
    one = ours.simulate(ours.box_scene(dims_m, absorption, 0.0), source, [mic], ism_order=ORDER)[0]
    yield "roomeq rendered", one.rir, 0.0, (ours.REFLECTIONS_FROM_HZ, ours.FS_HZ)
    pra = peer.load()
    if pra:
        pra.constants.set("rir_hpf_enable", False)
        responses, _ = peer.hybrid(dims_m, absorption, 0.0, source, [mic], n_rays=0, order=ORDER)
        pra.constants.set("rir_hpf_enable", True)
        yield "pyroomacoustics rendered", responses[0].rir, pra.constants.get("frac_delay_length") // 2, None


def _fitted(rir, length_m, lag, gain, dims_m, cut_hz):
    """Worst arrival and level of the isolated paths that come before any of the next order."""
    limit_m = ORDER * min(dims_m) - 2.5  # ORDER + 1 reflections are longer by more than any filter
    early = length_m < limit_m
    level_db, shift = fit_pulses(rir, length_m[early] / SPEED_M_S * ours.FS_HZ + lag, gain[early], cut_hz)
    return float(np.max(np.abs(shift))), float(np.max(np.abs(level_db))), len(shift)


def _name(dims_m):
    return "x".join(f"{size:g}" for size in dims_m)
