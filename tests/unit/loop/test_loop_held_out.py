"""A test set shares no recording with the RIRs that the loop is closed on."""

import re

import numpy as np
import pytest
from rirmaker import coloured_rir, row, write_rir_dir
from scipy.signal import butter, resample_poly, sosfilt

from roomeq.acoustics.same_recordings import SAME, cut_parts, find_same
from roomeq.loop.held_out import FURTHER_TAKE, held_out_rirs
from roomeq.loop.step import close_loop
from roomeq.loop.usable import LeftOut, usable_rirs

ROOMS = ("x", "y", "z")


def place(n):
    return dict(source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[3.0 + n, 3.0, 1.2])


def rir_dir(where, first, rooms=ROOMS):
    """Write two RIRs a room, whose ids and recordings are numbered from the first on."""
    return write_rir_dir(where, [(row(f"r{first + n}", room, **place(n % 2)), coloured_rir(first + n, time_s=0.3))
                                 for n, room in enumerate(np.repeat(rooms, 2))])


def shortened(rir):
    """Return a recording without most of its time of flight and its end, inverted, at another level and in 16 bits."""
    return np.round(-0.4 * rir[250:-1000] * 2 ** 15) / 2 ** 15


def resampled(rir, up, down):
    """Return a recording that was stored at another sampling rate."""
    return resample_poly(resample_poly(rir, up, down), down, up)


def delayed(rir, samples):
    """Return a recording with a delay by a fraction of a sample."""
    turned = np.exp(-2j * np.pi * samples * np.fft.rfftfreq(2 * len(rir)))
    return np.fft.irfft(np.fft.rfft(rir, 2 * len(rir)) * turned)[:len(rir)]


COPIES = {
    "identical": lambda rir: rir, "shortened": shortened,
    "16 bits, peak -40 dB": lambda rir: np.round(0.01 * rir / np.abs(rir).max() * 2 ** 15) / 2 ** 15,
    "by 48 kHz": lambda rir: resampled(rir, 3, 1), "by 44.1 kHz": lambda rir: resampled(rir, 441, 160),
    "half a sample": lambda rir: delayed(rir, 0.5),
    "high-pass": lambda rir: sosfilt(butter(2, 20.0, "high", fs=16000, output="sos"), rir),
    "low-pass": lambda rir: sosfilt(butter(4, 7000.0, "low", fs=16000, output="sos"), rir),
    "150 ms": lambda rir: rir[:320 + 2400],
}


def held_out(test, rirs):
    return held_out_rirs(usable_rirs([test]), usable_rirs([rirs]).rirs)


def test_set_that_is_trained_on_is_refused_as_test_set(tmp_path):
    rirs = rir_dir(tmp_path / "rirs", 0)
    with pytest.raises(ValueError) as refused:
        close_loop([rirs], tmp_path / "loop", test=[rirs])
    assert str(refused.value) == (
        f"test set: {rirs}/audio/r0.wav: RIR r0 of room x is in {rirs} as well: the error of a test set is that of "
        "recordings which took no part in a fit: take it out of one of the two sets")
    assert not (tmp_path / "loop").exists()


@pytest.mark.parametrize("change", COPIES.values(), ids=COPIES)
def test_copy_under_another_id_and_room_is_refused(tmp_path, change):
    rirs = rir_dir(tmp_path / "rirs", 0)
    test = write_rir_dir(tmp_path / "test", [(row("other", "x", **place(0)), coloured_rir(9)),
                                             (row("same", "hall", suspicious=None, **place(0)),
                                              change(coloured_rir(3, time_s=0.3)))])
    with pytest.raises(ValueError, match=re.escape(
            f"test set: {test}/audio/same.wav: RIR same of room hall is the recording of RIR r3 of room y in {rirs}: "
            "the error of a test set")):
        held_out(test, rirs)


def diffuse(rng, places_m, n_waves=2000):
    """Return RIRs in a diffuse field of plane waves that decay by 60 dB in 0.4 s, shape (n_places, n_samples)."""
    directions = rng.standard_normal((n_waves, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    arrival = np.append(400.0, rng.uniform(420.0, 4400.0, n_waves - 1))
    level = rng.standard_normal(n_waves) * 10.0 ** (-3.0 * (arrival - 400.0) / 6400.0)
    level[0] = 20.0
    bins = np.arange(4097) / 8192
    spectra = np.zeros((len(places_m), len(bins)), dtype=complex)
    for n, place_m in enumerate(places_m):
        samples = arrival + directions @ np.array(place_m) / 343.2 * 16000
        for first in range(0, n_waves, 200):
            part = slice(first, first + 200)
            spectra[n] += level[part] @ np.exp(-2j * np.pi * np.multiply.outer(samples[part], bins))
    return np.fft.irfft(spectra)


def test_two_channels_of_an_array_are_no_copies():
    rng = np.random.default_rng(0)
    rirs = diffuse(rng, [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.0, 0.04]])
    parts = np.array([cut_parts(rir, np.argmax(np.abs(rir))) for rir in rirs])
    assert [*find_same(parts)] == []
    noisy = rirs[0] + 1e-3 * np.abs(rirs[0]).max() * rng.standard_normal(len(rirs[0]))
    (pair,) = find_same(parts, cut_parts(noisy, np.argmax(np.abs(noisy)))[None])
    assert pair[:2] == (0, 0) and SAME < pair.correlation < 1.0


def test_further_takes_of_a_position_are_left_out_and_counted(tmp_path, caplog):
    caplog.set_level("INFO")
    rirs = rir_dir(tmp_path / "rirs", 0)
    noise = np.random.default_rng(0).standard_normal(len(coloured_rir(0, time_s=0.3)))
    take = coloured_rir(2, time_s=0.3) + 2e-2 * np.abs(coloured_rir(2, time_s=0.3)).max() * noise
    test = write_rir_dir(tmp_path / "test", [
        (row("take", "y", **place(0)), take), (row("marked", "z", repeat_of="r5", **place(1.5)), coloured_rir(8)),
        (row("state", "y_dry", **place(0)), coloured_rir(7)), (row("mic", "y", mic_id="other", **place(0)),
                                                                coloured_rir(6))])
    found = held_out(test, rirs)
    assert [rir.row["id"] for rir in found.rirs] == ["mic", "state"]
    assert found.left_out == [LeftOut(FURTHER_TAKE, 2, 2)]
    assert "test set: left out: RIR take of room y: same positions as r2" in caplog.text


def test_rooms_positions_and_ids_of_other_rooms_may_be_in_both(tmp_path):
    rirs = rir_dir(tmp_path / "rirs", 0)
    held_out(rir_dir(tmp_path / "same_rooms", 10), rirs)
    held_out(write_rir_dir(tmp_path / "same_id", [(row("r0", "hall", **place(0)), coloured_rir(9))]), rirs)
