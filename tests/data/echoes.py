"""RIRs of shoeboxes by image sources, written independently of the simulator, for tests of estimated geometry."""

import itertools

import numpy as np

FS_HZ = 16000
ORDER, HALF = 6, 24


def echo_rir(rng, dims_m, source_m, mic_m, amplitudes, *, response, speed_m_s=343.2, latency_s=0.0, length_s=0.25,
             decay_s=0.4, snr_db=50.0):
    """Return an RIR: images of up to six reflections, a diffuse tail, a loudspeaker and noise.

    Parameters
    ----------
    amplitudes : sequence of 6 floats
        Reflection factor of the walls x=0, x=L, y=0, y=L, floor, ceiling.
    response : ndarray
        Impulse response of the loudspeaker.
    """
    n = round(length_s * FS_HZ)
    rir = np.zeros(n + HALF)
    cells = range(-ORDER, ORDER + 1)
    for cell in itertools.product(cells, cells, cells):
        if sum(map(abs, cell)) > ORDER:
            continue
        gain, square = 1.0, 0.0
        for axis, k in enumerate(cell):
            at = k * dims_m[axis] + (source_m[axis] if k % 2 == 0 else dims_m[axis] - source_m[axis])
            square += (at - mic_m[axis]) ** 2
            far = (abs(k) + (k > 0)) // 2
            gain *= amplitudes[2 * axis + 1] ** far * amplitudes[2 * axis] ** (abs(k) - far)
        time = np.sqrt(square) / speed_m_s * FS_HZ + latency_s * FS_HZ
        first = int(time) - HALF + 1
        if first < 0 or first + 2 * HALF > len(rir):
            continue
        at = np.arange(first, first + 2 * HALF)
        pulse = np.sinc(at - time) * np.cos(0.5 * np.pi * (at - time) / HALF) ** 2
        n_reflections = sum(map(abs, cell))
        if n_reflections:  # rough walls: each reflection is a little spread, and not the same twice
            pulse = np.convolve(pulse, [1.0, *(0.2 * rng.standard_normal(3))])[:len(pulse)]
        rir[at] += gain / np.sqrt(square) * pulse
    t = np.arange(n) / FS_HZ
    start = np.linalg.norm(np.subtract(source_m, mic_m)) / speed_m_s + latency_s
    tail = rng.standard_normal(n) * np.exp(-6.9 * t / decay_s) * np.clip((t - start) / 0.02, 0.0, 1.0)
    rir = np.convolve(rir[:n] + 0.03 * tail, response)[:n]
    return rir + 10.0 ** (-snr_db / 20.0) * np.abs(rir).max() * rng.standard_normal(n)


def echo_room(seed, *, n_sources=2, n_mics=4, ceiling_off_m=0.0, position_sd_m=0.01, known=(), tof_removed=True):
    """Return the rows and RIRs of a random room, and the true heights by quantity.

    Parameters
    ----------
    ceiling_off_m : float
        Documented height of the room minus the true one.
    position_sd_m : float
        Error of each documented coordinate.
    known : collection of str
        Positions whose heights the rows state: "source_pos_m", "mic_pos_m".
    """
    rng = np.random.default_rng(seed)
    dims_m = rng.uniform([4.0, 3.0, 2.4], [9.0, 7.0, 3.6])
    amplitudes = np.sqrt(1.0 - rng.uniform(0.05, 0.7, 6))
    response = np.concatenate([[1.0], 0.4 * rng.standard_normal(12) * 0.6 ** np.arange(12)])
    sources_m, mics_m = (np.column_stack([rng.uniform(0.6, dims_m[axis] - 0.6, count) for axis in range(2)]
                                         + [np.clip(1.3 + 0.3 * rng.standard_normal(count), 0.5, dims_m[2] - 0.4)])
                         for count in (n_sources, n_mics))
    truth = {"height of the room": dims_m[2]}
    truth |= {f"height of source s{n}": at[2] for n, at in enumerate(sources_m)}
    truth |= {f"height of microphone m{n}": at[2] for n, at in enumerate(mics_m)}

    def stated(at_m, key):
        at_m = [round(float(x), 3) for x in at_m + position_sd_m * rng.standard_normal(3)]
        return at_m if key in known else [*at_m[:2], None]

    stated_sources = [stated(at, "source_pos_m") for at in sources_m]
    stated_mics = [stated(at, "mic_pos_m") for at in mics_m]
    rows, rirs = [], []
    for s, m in itertools.product(range(n_sources), range(n_mics)):
        rir = echo_rir(rng, dims_m, sources_m[s], mics_m[m], amplitudes, response=response)
        if tof_removed:
            rir = rir[max(0, int(np.linalg.norm(sources_m[s] - mics_m[m]) / 343.2 * FS_HZ) - 40):]
        rows.append(dict(id=f"s{s}_m{m}", wav=f"s{s}_m{m}.wav", room_id=f"room{seed}", source_id=f"s{s}",
                         mic_id=f"m{m}", fs_hz=FS_HZ, n_samples=len(rir), tof_removed=tof_removed, temperature_c=20.0,
                         room_dims_m=[round(float(x), 3) for x in dims_m + np.array([0.0, 0.0, ceiling_off_m])],
                         source_pos_m=stated_sources[s], mic_pos_m=stated_mics[m]))
        rirs.append(rir)
    return rows, rirs, truth
