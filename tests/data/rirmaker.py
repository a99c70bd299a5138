"""Synthetic RIRs for tests: coloured decaying noise, and RIR directories."""

import numpy as np

from roomeq.core.audio import write_wav
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.records.rir_dir import write_noises, write_rirs

DIRECT = 320


def coloured_rir(seed, *, time_s=0.4, length_s=0.6, eq_db=(0.0,) * 8, snr_db=None, direct=2.0):
    """Return decaying noise with a given octave spectrum; the direct sound is at sample `DIRECT`."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(length_s * FS_HZ)) / FS_HZ
    rir = np.concatenate([np.zeros(DIRECT), rng.standard_normal(len(t)) * 10.0 ** (-3.0 * t / time_s)])
    rir[DIRECT] = direct
    f = np.fft.rfftfreq(2 * len(rir), 1.0 / FS_HZ)
    gain_db = np.interp(np.log(np.maximum(f, 1.0)), np.log(EXACT_BANDS_HZ), eq_db)
    rir = np.fft.irfft(np.fft.rfft(rir, 2 * len(rir)) * 10.0 ** (gain_db / 20.0))[:len(rir)]
    if snr_db is not None:
        rir += 10.0 ** (-snr_db / 20.0) * rng.standard_normal(len(rir))
    return 0.2 * rir


def row(rir_id, room_id="hall", **more):
    """Return the row of an RIR with the required keys only."""
    return dict(id=rir_id, room_id=room_id, source_id="s", mic_id="m", room_dims_m=[6.0, 5.0, 3.0],
                source_pos_m=None, mic_pos_m=None) | more


def write_rir_dir(directory, items, noises=()):
    """Write an RIR directory of (row, rir) pairs, and noises (rows without `wav`) of half a second."""
    rows = []
    for item, rir in items:
        write_wav(directory / "audio" / f"{item['id']}.wav", rir)
        rows.append(item | dict(wav=f"audio/{item['id']}.wav", fs_hz=FS_HZ, n_samples=len(rir)))
    write_rirs(directory, rows)
    for noise in noises:
        rng = np.random.default_rng(list(f"{directory.name} {noise['id']}".encode()))
        write_wav(directory / "audio" / f"{noise['id']}.wav", 0.01 * rng.standard_normal(FS_HZ // 2))
    if noises:
        write_noises(directory, [dict(kind="ambient", duration_s=0.5, fs_hz=FS_HZ, wav=f"audio/{noise['id']}.wav")
                                 | noise for noise in noises])
    return directory
