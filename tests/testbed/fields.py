"""Effects of the room and of the air in it."""

import numpy as np
from scipy.signal import sosfilt

from testbed.draws import C0, DECLARED_C, DECLARED_PCT, FREQUENCY_HZ, FS_HZ, OCTAVES_HZ, generator, speed_of_sound
from testbed.render import Extra
from testbed.trace import BIN_M, N_BINS

AIRS = ((10.0, 20.0), (30.0, 80.0))  # degrees C, % relative humidity
HOTTEST_C = 35.0


def draw_air(seed, rooms):
    """One of the two extremes."""
    temperature, humidity = AIRS[int(generator(seed, "air").integers(2))]
    return dict(temperature_c=temperature, humidity_pct=humidity)


def air(parameters, scale):
    """Absorbing air part of the way from the declared one to the extreme."""
    return Extra(air=(DECLARED_C + scale * (parameters["temperature_c"] - DECLARED_C),
                      DECLARED_PCT + scale * (parameters["humidity_pct"] - DECLARED_PCT)))


def draw_temperature(seed, rooms):
    """The hottest."""
    return dict(temperature_c=HOTTEST_C)


def temperature(parameters, scale):
    """Another speed of sound; the air absorbs as declared."""
    return Extra(speed=speed_of_sound(DECLARED_C + scale * (parameters["temperature_c"] - DECLARED_C)))


def draw_desk(seed, rooms):
    """A desk under sources and microphones of each room: height, what it reflects at scale 1, size."""
    result = {}
    for room in rooms:
        rng = generator(seed, "desk", room.room_id)
        heights = np.concatenate([room.sources_m[:, 2], room.mics_m[:, 2]])
        height = min(heights.mean() - rng.uniform(0.6, 0.8), heights.min() - 0.3)
        result[room.room_id] = dict(height_m=float(height), reflection=float(rng.uniform(0.85, 1.0)),
                                    width_m=float(rng.uniform(0.8, 1.6)))
    return result


def desk(parameters, scale):
    """A coherent reflection off the desk.

    A plate reflects weakly what is long against its Fresnel zone (Rindel, Acta Acustica 1 (1993) 209).
    """
    def pulses(field):
        plate = parameters[field.room.room_id]
        source, mic = field.room.sources_m[field.rir.source], field.room.mics_m[field.rir.mic]
        image = source * [1, 1, -1] + [0.0, 0.0, 2.0 * plate["height_m"]]
        way = mic - image
        length = np.linalg.norm(way)
        up = (source[2] - plate["height_m"]) / way[2] * length  # part of the way before the desk
        corner_hz = 343.0 * 2.0 * up * (length - up) / length / (2.0 * plate["width_m"] ** 2 * way[2] / length)
        gain = scale * plate["reflection"] / (1.0 - 1j * corner_hz / np.maximum(FREQUENCY_HZ, 1e-3))
        return [(length, way * [1, 1, -1] / length, gain)]
    return Extra(pulses=pulses)


def draw_directivity(seed, rooms):
    """Per loudspeaker: how fast its beam narrows with frequency, and what it keeps behind."""
    result = {}
    for name in ("spk1", "spk2"):
        rng = generator(seed, "directivity", name)
        result[name] = dict(width=float(rng.uniform(0.8, 1.25)), slope=float(rng.uniform(0.4, 0.8)),
                            behind=float(rng.uniform(0.05, 0.15)))
    return result


def directivity(parameters, scale):
    """A beam ((1 + cos)/2)^p over a floor, p growing as a power of frequency from `scale` at 1 kHz; 1 on axis."""
    def departing(field, cosine):
        beam = parameters[field.rir.source_id]
        power = scale * beam["width"] * (OCTAVES_HZ / 1000.0) ** beam["slope"]
        narrow = np.clip((1.0 + cosine) / 2.0, 1e-9, 1.0) ** power[:, None]
        # what remains behind matters as far as there is a beam
        behind = beam["behind"] * np.minimum(power, 1.0)[:, None]
        return behind + (1.0 - behind) * narrow
    return Extra(departing=departing)


def draw_coupled(seed, rooms):
    """Per room: volume and reverberation times of the room next door, opening at scale 1."""
    result = {}
    for room in rooms:
        rng = generator(seed, "coupled", room.room_id)
        slow = np.clip(rng.uniform(2.5, 4.5) * np.median(room.eyring_s[3:6]), 1.5, 4.0)
        times = slow * np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.9, 0.7, 0.45])
        result[room.room_id] = dict(volume_m3=float(rng.uniform(100.0, 400.0)), times_s=times.tolist(),
                                    opening_m2=float(rng.uniform(0.7, 1.3)))
    return result


def coupled(parameters, scale):
    """Energy goes to the room next door and comes back late (Kuttruff, Room Acoustics, 5.8)."""
    def decay(field, energy, speed):
        room = parameters[field.room.room_id]
        step_s = BIN_M / C0
        out = C0 * scale * room["opening_m2"] / (4.0 * field.room.volume_m3)
        back = C0 * scale * room["opening_m2"] / (4.0 * room["volume_m3"])
        rate_here = 13.8 / field.room.eyring_s + out
        rate_there = 13.8 / np.array(room["times_s"]) + back
        lost = energy * np.exp(-out * step_s * np.arange(N_BINS))
        early = np.zeros_like(energy)  # specular paths feed it too
        for length, gain in zip(field.images.length_m[1:], field.images.gain.T[1:], strict=True):
            if length < N_BINS * BIN_M:
                early[:, int(length / BIN_M)] += (gain / (4.0 * np.pi * length)) ** 2
        result = lost.copy()
        here, there = np.zeros(len(energy)), np.zeros(len(energy))
        for k in range(N_BINS):
            result[:, k] += here
            there = there * np.exp(-rate_there * step_s) + out * step_s * (lost[:, k] + early[:, k] + here)
            here = here * np.exp(-rate_here * step_s) + back * step_s * there
        return result
    return Extra(decay=decay)


def draw_ringing(seed, rooms):
    """Per room an object that rings: frequency, decay time, and how loud at scale 1."""
    result = {}
    for room in rooms:
        rng = generator(seed, "ringing", room.room_id)
        result[room.room_id] = dict(frequency_hz=float(np.exp(rng.uniform(np.log(350.0), np.log(2500.0)))),
                                    time_s=float(rng.uniform(1.0, 2.0)), level=float(np.exp(rng.normal(0.0, 0.15))))
    return result


def ringing(parameters, scale):
    """A resonator that the field in the room excites and that sounds on."""
    def response(field, rir):
        thing = parameters[field.room.room_id]
        turn = 2.0 * np.pi * thing["frequency_hz"] / FS_HZ
        keep = np.exp(-6.908 / (thing["time_s"] * FS_HZ))
        # as loud as the field at its frequency
        gain = scale * thing["level"] * 13.8 / (thing["time_s"] * FS_HZ)
        section = [0.0, gain * keep * np.sin(turn), 0.0, 1.0, -2.0 * keep * np.cos(turn), keep ** 2]
        return rir + sosfilt([section], rir)
    return Extra(response=response)
