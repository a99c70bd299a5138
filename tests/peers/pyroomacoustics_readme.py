"""The first example of pyroomacoustics' README in roomeq, and beside it: the same room, sooner.

Needs roomeq and pyroomacoustics. It exits with status 1 where the two differ by more than the tolerances below.
"""

import sys
import time

import numpy as np
import pyroomacoustics as pra

import roomeq

DIMS_M, SOURCE_M, MICS_M = (9.0, 7.5, 3.5), (2.5, 3.73, 1.76), [(6.3, 4.87, 1.2), (6.3, 4.93, 1.2)]
T60_S = 0.6
PRA_DELAY = 40  # samples by which pyroomacoustics delays every response, for its fractional delays
TOLERANCES = {"arrival [samples]": 1.0, "direct sound [dB]": 1.0, "T20 [%]": 10.0, "C50 [dB]": 1.5}
"""pyroomacoustics adds noise to its direct sound and scatters by some of them from seed to seed."""


def with_pyroomacoustics(fs):
    pra.random.seed(0)
    absorption, _ = pra.inverse_sabine(T60_S, DIMS_M)
    room = pra.ShoeBox(DIMS_M, fs=fs, materials=pra.Material(absorption, 0.1), max_order=3, ray_tracing=True,
                       air_absorption=True)
    room.set_ray_tracing(n_rays=20000)
    room.add_source(SOURCE_M)
    room.add_microphone_array(np.array(MICS_M).T)
    room.compute_rir()
    return [mic[0][PRA_DELAY:] / (4.0 * np.pi) for mic in room.rir], absorption


def with_roomeq(fs, absorption):
    room = roomeq.Room(DIMS_M, materials={"absorption": absorption, "scattering": 0.1})
    return roomeq.simulate_rir(room, SOURCE_M, MICS_M, fs=fs)


def timed(function, *arguments):
    start = time.perf_counter()
    result = function(*arguments)
    return result, time.perf_counter() - start


def level_db(rir, fs, near):
    """Return the level of a part of a response below 7 kHz; above 8 kHz pyroomacoustics knows no absorption of air."""
    spectrum = np.abs(np.fft.rfft(rir[near], 4096)) ** 2
    return 10 * np.log10(spectrum[np.fft.rfftfreq(4096, 1 / fs) < 7000].mean())


def differences(fs, ours, theirs):
    """Return the largest difference of the direct sounds, and those of T20 and C50 in the mean of 500 Hz to 4 kHz."""
    found, means = {name: 0.0 for name in TOLERANCES}, []
    for mic, our, their in zip(MICS_M, ours, theirs, strict=True):
        expected = np.linalg.norm(np.subtract(mic, SOURCE_M)) / 343.2 * fs
        near = slice(round(expected) - 8, round(expected) + 9)
        arrivals = [np.argmax(np.abs(rir[near])) for rir in (our, their)]
        levels_db = [level_db(rir, fs, near) for rir in (our, their)]
        found["arrival [samples]"] = max(found["arrival [samples]"], abs(float(np.subtract(*arrivals))))
        found["direct sound [dB]"] = max(found["direct sound [dB]"], abs(float(np.subtract(*levels_db))))
        parameters = [roomeq.analyse(rir, fs, direct=(expected, 1)) for rir in (our, their)]
        means.append([[np.mean(one[key][3:7]) for key in ("t20_s", "c50_db")] for one in parameters])
    (our_t20_s, our_c50_db), (their_t20_s, their_c50_db) = np.mean(means, axis=0)
    found["T20 [%]"] = 100 * abs(our_t20_s / their_t20_s - 1)
    found["C50 [dB]"] = abs(our_c50_db - their_c50_db)
    return found


def main():
    wrong = False
    roomeq.simulate_rir(roomeq.Room((3, 3, 3), t60_s=0.3), (1, 1, 1), (2, 2, 2))  # compiles where nobody has yet
    for fs in (16000, 48000):
        (theirs, absorption), their_s = timed(with_pyroomacoustics, fs)
        ours, our_s = timed(with_roomeq, fs, absorption)
        print(f"{fs} Hz: pyroomacoustics {their_s:.2f} s, roomeq {our_s:.2f} s: {their_s / our_s:.1f} times as fast")
        for name, value in differences(fs, ours, theirs).items():
            print(f"  {name:18} differs by {value:.2f} (at most {TOLERANCES[name]:g})")
            wrong |= value > TOLERANCES[name]
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
