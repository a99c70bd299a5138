#!/usr/bin/env python3
"""Generate a synthetic corpus of "measured" RIRs, in the layout of BUT ReverbDB as released.

Usage: make_synthetic_rirs.py [--rooms 9] [--mics 6] [--speakers 6] [--silence-s 10] [--seed 0] [--nj 2] OUT_DIR
e.g.:  python local/make_synthetic_rirs.py --nj 2 corpora/synthetic_rirs

Nothing in it is measured. It contains the irregularities of the released corpus: two takes of a position, a
retransmission session (_T) at a position of another session, a meta file without furniture, a meta file with another
name, a position outside its room, two silence files in a folder, a stairwell.
"""

import argparse
import datetime
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

import synthetic_acoustics
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.files import write_text
from roomeq.core.rng import rng_for
from synthetic_acoustics import FS_HZ, LOUDSPEAKERS, N_OUT, OCTAVES_HZ, FloatArray, Room, impulse_responses


class RoomDescription(NamedTuple):
    """What the meta file of a room states, and its decay time."""

    name: str
    kind: str
    subtype: str
    dims_m: tuple[float, float, float]  # depth, width, height
    t60_s: float  # at 1 kHz
    walls: str
    floor: str
    ceiling: str
    furniture_percent: int


# Audio depends on the names of rooms ("Standin_...") and on the texts given to `rng_for` ("standin-..."): keep them.
TABLE = tuple(map(RoomDescription._make, (
    ("Standin_Office_A101", "office", "small", (6.1, 5.4, 3.05), 0.50, "plaster", "carpet", "tiles", 30),
    ("Standin_Meeting_B210", "meeting room", "medium", (7.8, 5.2, 3.1), 0.38, "wood", "carpet", "tiles", 25),
    ("Standin_Stairs_S3", "stairs", "uncommon", (6.2, 2.7, 12.9), 1.30, "concrete", "stone", "concrete", 0),
    ("Standin_Class_C312", "class room", "medium", (9.6, 7.3, 3.3), 0.70, "plaster", "linoleum", "plaster", 20),
    ("Standin_Lecture_E104", "lecture room", "large", (13.8, 10.4, 4.4), 0.90, "plaster", "wood", "tiles", 35),
    ("Standin_Lab_L005", "laboratory", "medium", (8.4, 6.7, 3.6), 0.58, "plaster", "linoleum", "plaster", 40),
    ("Standin_Hall_D2", "lecture room", "hall", (19.5, 15.2, 6.1), 1.15, "wood", "carpet", "plaster", 45),
    ("Standin_Conference_K1", "conference", "large", (16.8, 9.7, 3.4), 0.80, "plaster", "carpet", "tiles", 20),
    ("Standin_Studio_T9", "studio", "treated", (7.1, 5.9, 3.2), 0.27, "foam", "carpet", "foam", 15),
)))
# rooms beyond the table: type, subtype, smallest and largest depth, width, height [m], range of T60 at 1 kHz [s]
KINDS = (
    ("office", "small", (4.2, 3.6, 2.7), (6.8, 5.6, 3.3), (0.35, 0.75)),
    ("meeting room", "medium", (5.8, 4.4, 2.7), (9.5, 6.6, 3.4), (0.30, 0.70)),
    ("class room", "medium", (7.6, 6.2, 2.9), (11.0, 8.4, 3.7), (0.45, 1.00)),
    ("laboratory", "medium", (6.0, 5.0, 2.9), (10.5, 8.0, 4.0), (0.40, 0.90)),
    ("lecture room", "large", (11.0, 8.5, 3.4), (18.0, 14.0, 5.6), (0.60, 1.20)),
    ("conference", "large", (10.0, 7.0, 2.9), (17.0, 10.5, 3.8), (0.40, 0.95)),
    ("studio", "treated", (4.6, 3.8, 2.6), (7.6, 6.0, 3.3), (0.25, 0.40)),
)
MATERIALS = {"walls": ("plaster", "wood", "concrete", "gypsum"), "floor": ("carpet", "linoleum", "wood", "stone"),
             "ceiling": ("tiles", "plaster", "concrete")}
MAX_ROOMS = 80
REPEATED, OUTSIDE, RETRANSMITTED, NO_FURNITURE, OTHER_NAME = 0, 1, 1, 2, 1  # rooms with an irregularity
SILENT_MICS = 3  # microphones of a room's first session that also have recordings of background noise
GAIN = 0.5 * 4 * np.pi * 0.9  # the nearest position peaks at about half of full scale
SWEEP = "IR_sweep_15s_45Hzto22kHz_FS16kHz"
README = """Generated, not measured: a synthetic corpus of room impulse responses.

Made by local/make_synthetic_rirs.py: damped modes of rigid shoeboxes below 250-350 Hz, image sources and a decaying
noise tail above, two directional loudspeakers with different frequency responses in turn, microphone noise. Rooms,
positions and meta files are generated, too. The layout is that of BUT ReverbDB (doi 10.1109/JSTSP.2019.2917582), so
the same reader reads both; no file of that corpus is included.
"""


@dataclass(frozen=True)
class Corpus:
    """Options that determine every byte of the corpus."""

    rooms: int
    mics: int
    speakers: int
    silence_s: int
    seed: int


@dataclass(frozen=True)
class Session:
    """One loudspeaker position in a room; `speaker` counts from 1, `kind` is S (sweeps) or T (retransmission)."""

    room: int
    room_name: str
    speaker: int
    kind: str = "S"

    @property
    def model(self) -> int:
        """Index into `LOUDSPEAKERS`: positions alternate between the two, alike in all rooms."""
        return (self.speaker - 1) % len(LOUDSPEAKERS)

    @property
    def folder(self) -> str:
        """Path in the corpus."""
        days = 70 * (self.room % len(TABLE)) + self.speaker - 1 + (35 if self.kind == "T" else 0)
        date = datetime.date(2019, 5, 3) + datetime.timedelta(days)
        return f"{self.room_name}/MicID01/SpkID{self.speaker:02d}_{date:%Y%m%d}_{self.kind}"


def describe_room(corpus: Corpus, index: int) -> RoomDescription:
    """Return a room of the table; rooms beyond it are drawn, small ones with shorter decays on average."""
    if index < len(TABLE):
        return TABLE[index]
    rng = rng_for(corpus.seed, "standin-description", str(index))
    kind, subtype, smallest_m, largest_m, (shortest_s, longest_s) = KINDS[index % len(KINDS)]
    size = rng.uniform(0, 1, 3)
    dims_m = tuple((np.array(smallest_m) + size * np.subtract(largest_m, smallest_m)).round(2).tolist())
    live = 0.5 * size.mean() + 0.5 * rng.uniform()  # larger rooms tend to have longer decays
    t60_s = round(shortest_s + live * (longest_s - shortest_s), 2)
    walls, floor, ceiling = (str(rng.choice(names)) for names in MATERIALS.values())
    if subtype == "treated":
        walls, floor, ceiling = "foam", "carpet", "foam"
    name = f"Standin_{kind.split()[0].capitalize()}_R{index:03d}"
    return RoomDescription(name, kind, subtype, dims_m, t60_s, walls, floor, ceiling, int(rng.integers(2, 10)) * 5)


def sessions(corpus: Corpus) -> dict[str, Session]:
    """Return all sessions of the corpus by folder."""
    names = [describe_room(corpus, room).name for room in range(corpus.rooms)]
    listed = [Session(room, name, speaker + 1) for room, name in enumerate(names) for speaker in range(corpus.speakers)]
    if corpus.rooms > RETRANSMITTED:
        listed.append(Session(RETRANSMITTED, names[RETRANSMITTED], 1, "T"))
    return {session.folder: session for session in listed}


def draw_room(corpus: Corpus, index: int) -> Room:
    """Return the acoustics of a room.

    Decay times without air grow by 30-80 % towards 62.5 Hz and fall by 5-25 % towards 8 kHz.
    """
    described = describe_room(corpus, index)
    rng = rng_for(corpus.seed, "standin-room", described.name)
    octaves_below = np.log2(1000 / OCTAVES_HZ)
    shape = np.where(octaves_below > 0, 1 + rng.uniform(0.3, 0.8) * np.abs(octaves_below / 4) ** 1.5,
                     1 + rng.uniform(0.05, 0.25) * octaves_below / 3)
    shape *= rng.uniform(0.95, 1.05, 8)
    share = rng.uniform(0.5, 1.6, 6)
    room = Room(np.array(described.dims_m), described.t60_s * rng.uniform(0.92, 1.08) * shape, share,
                rng.uniform(0.1, 0.3), round(rng.uniform(19, 24), 1), int(rng.integers(2**31)))
    return replace(room, wall_share=share / np.average(share, weights=room.wall_areas_m2))


def draw_positions(corpus: Corpus, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return loudspeaker positions [m], unit vectors of their axes, and microphone positions [m], each (n, 3)."""
    described = describe_room(corpus, index)
    rng = rng_for(corpus.seed, "standin-positions", described.name)
    dims_m = np.array(described.dims_m)
    top_m = dims_m[2] - 0.4 if dims_m[2] > 8 else 1.8  # loudspeakers in the stairwell stand on all floors
    speakers = rng.uniform([0.5, 0.5, 0.9], [*dims_m[:2] - 0.5, top_m], (corpus.speakers, 3)).round(3)
    turned = rng.normal(0, np.radians(40), corpus.speakers)
    towards = np.arctan2(*(dims_m / 2 - speakers).T[1::-1]) + turned
    facing = np.stack([np.cos(towards), np.sin(towards), np.zeros(corpus.speakers)], 1)
    mics: list[FloatArray] = []
    while len(mics) < corpus.mics:
        mic = rng.uniform(0.3, np.minimum(dims_m - 0.3, [np.inf, np.inf, max(top_m, 2.4)])).round(3)
        if np.linalg.norm(speakers - mic, axis=1).min() > 0.9:
            mics.append(mic)
    return speakers, facing, np.array(mics)


def microphone_noise(rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Return noise of about unit power: white, with a rise towards low frequencies below 150 Hz."""
    spectrum = np.fft.rfft(rng.standard_normal(n_samples))
    freqs_hz = np.fft.rfftfreq(n_samples, 1 / FS_HZ)
    return np.fft.irfft(spectrum * np.sqrt(1 + 150 / np.maximum(freqs_hz, 20)), n_samples)


def background_noise(corpus: Corpus, room_name: str, mic_name: str) -> FloatArray:
    """Return the recording of a quiet room: noise with a falling spectrum, ventilation, hum, microphone noise."""
    n_samples = corpus.silence_s * FS_HZ
    room = rng_for(corpus.seed, "standin-background", room_name)
    freqs_hz = np.fft.rfftfreq(n_samples, 1 / FS_HZ).clip(10)
    spectrum = (freqs_hz / 100) ** -room.uniform(0.4, 0.8)
    centre_hz, width = room.uniform(90, 350), room.uniform(0.3, 0.8)
    spectrum += room.uniform(0.3, 2) * np.exp(-0.5 * (np.log(freqs_hz / centre_hz) / width) ** 2)
    harmonics = 50 * np.arange(1, 9)
    hum = room.uniform(0.02, 0.3) * 10 ** (-room.uniform(0, 30, 8) / 20)
    level = 10 ** (room.uniform(-56, -44) / 20)
    rng = rng_for(corpus.seed, "standin-background", mic_name)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(n_samples)) * spectrum, n_samples)
    time_s = np.arange(n_samples) / FS_HZ
    phases = 2 * np.pi * (harmonics[:, None] * time_s + rng.random((8, 1)))
    noise += hum @ np.sin(phases) * noise.std()
    noise *= 10 ** (rng.normal(0, 1) / 20) * level / noise.std()
    return noise + 10 ** (-78 / 20) * microphone_noise(rng, n_samples)


def meta_text(title: str, rows: list[tuple[str, object]]) -> str:
    """Return a meta file in the released format: a banner, then ``$Key<TAB>value`` lines."""
    banner = "#" * 40
    return f"{banner}\n# {title}\n{banner}\n" + "".join(f"${key}\t{value}\n" for key, value in rows)


def room_meta(corpus: Corpus, index: int) -> str:
    """Return the meta file of a room."""
    described, room = describe_room(corpus, index), draw_room(corpus, index)
    rows: list[tuple[str, object]] = [
        ("EnvName", described.name), ("EnvType", described.kind), ("EnvSubType", described.subtype),
        ("EnvDescription", "generated, not measured")]
    rows += zip(("EnvDepth", "EnvWidth", "EnvHeight"), described.dims_m, strict=True)
    rows += [("EnvVolume", round(room.volume_m3, 1)), ("EnvMatWall", described.walls),
             ("EnvMatFloor", described.floor), ("EnvMatCeiling", described.ceiling),
             ("EnvTemp", room.temperature_c), ("EnvBCKNoiseLevel", 30 + index % len(TABLE))]
    if index != NO_FURNITURE:
        rows.append(("EnvFurniture", described.furniture_percent))
    return meta_text("ENVIRONMENT", rows)


def speaker_rows(speaker_m: FloatArray) -> list[tuple[str, object]]:
    """Return the meta rows of a loudspeaker position."""
    return list(zip(("EnvSpk1Depth", "EnvSpk1Width", "EnvSpk1Height"), speaker_m, strict=True))


def mic_meta(number: int, speaker_m: FloatArray, mic_m: FloatArray, t60_s: float) -> str:
    """Return the meta file of a microphone; `number` counts from 1."""
    path = mic_m - speaker_m
    key = f"EnvMic{number}"
    values: dict[str, object] = {
        "Depth": mic_m[0], "Width": mic_m[1], "Height": mic_m[2],
        "TypeID": f"01-{number}" if number <= 2 else "02", "RelDistance": round(np.linalg.norm(path), 2),
        "RelAzimuth": round(np.degrees(np.arctan2(path[1], path[0])), 1),
        "RelElevation": round(np.degrees(np.arcsin(path[2] / np.linalg.norm(path))), 1)}
    values |= {f"RelRT{decay}": round(t60_s, 3) for decay in (60, 30, 20)}
    rows = [*speaker_rows(speaker_m), ("EnvMicID", number), *((key + k, v) for k, v in values.items())]
    return meta_text("MICROPHONE", rows)


def make_session(corpus: Corpus, out_dir: Path, folder: str, session: Session) -> int:
    """Write one session and return its number of RIRs."""
    index, name = session.room, session.room_name
    room = draw_room(corpus, index)
    speakers, facings, mics = draw_positions(corpus, index)
    speaker_m, facing = speakers[session.speaker - 1], facings[session.speaker - 1]
    # The retransmission session repeats a position: same tail, different noise.
    rngs = [rng_for(corpus.seed, "standin-tail", f"{name} {session.speaker} {k}") for k in range(len(mics))]
    direct_samples = np.array([712 + rng.uniform(-1, 1) for rng in rngs])
    with threadpool_limits(1):  # sums must not depend on the number of threads
        responses = GAIN * impulse_responses(room, speaker_m, mics, facing, direct_samples, rngs,
                                             session.model)
    floor_db = rng_for(corpus.seed, "standin-floor", name).uniform(-65, -55)

    write_text(out_dir / folder / "spk_meta.txt", meta_text("SPEAKER", speaker_rows(speaker_m)))
    written = 0
    for k, (mic_m, response) in enumerate(zip(mics, responses, strict=True)):
        mic_dir = out_dir / folder / f"{k + 1:02d}"
        outside = index == OUTSIDE and session.speaker == 1 and k == 1
        stated_m = np.array([room.dims_m[0] + 0.31, *mic_m[1:]]) if outside else mic_m
        write_text(mic_dir / "mic_meta.txt", mic_meta(k + 1, speaker_m, stated_m, room.total_t60_s[4]))
        for take in range(2 if index == REPEATED and session.speaker == 1 and k < 2 else 1):
            rng = rng_for(corpus.seed, "standin-take", f"{folder} {k} {take}")
            floor = np.abs(response).max() * 10 ** ((floor_db + rng.normal(0, 1)) / 20)
            noisy = response + floor * microphone_noise(rng, N_OUT)
            write_wav(mic_dir / "RIR" / f"{SWEEP}.v{take:02d}.wav", noisy)
            written += 1
        if session.speaker == 1 and session.kind == "S" and k < SILENT_MICS:
            for take in range(2 if index == REPEATED and k == 0 else 1):
                write_wav(mic_dir / "silence" / f"silence.v{take:02d}.wav",
                          background_noise(corpus, name, f"{folder} {k} {take}"))
        if session.kind == "T" and k == 0:
            rng = rng_for(corpus.seed, "standin-retransmission", folder)
            n = 2 * FS_HZ
            bursts = np.abs(np.sin(4 * np.pi * np.arange(n) / FS_HZ)) * microphone_noise(rng, n)
            recorded = np.fft.irfft(np.fft.rfft(response, 2 * n) * np.fft.rfft(bursts, 2 * n))[:n]
            write_wav(mic_dir / "english/LibriSpeech/test-clean/1/2/1-2-0000.v00.wav", 0.1 * recorded)
    return written


def make_synthetic_rirs(out_dir: Path, corpus: Corpus, nj: int = 1) -> None:
    """Make the corpus.

    Parameters
    ----------
    out_dir
        Directory to make.
    corpus
    nj
        Number of processes; the result does not depend on it.

    Raises
    ------
    ValueError
        `out_dir` exists and was not made by this function.
    """
    build = Build(out_dir, step="synthetic-rirs", options=vars(corpus),
                  inputs=[Path(__file__), Path(synthetic_acoustics.__file__)])

    def assemble(directory: Path, counts: list[int]) -> None:
        for index in range(corpus.rooms):
            file = "env_full_meta.txt" if index == OTHER_NAME else "env_meta.txt"
            write_text(directory / describe_room(corpus, index).name / file, room_meta(corpus, index))
        write_text(directory / "README", README)
        print(f"{out_dir}: {sum(counts)} generated RIRs of {corpus.rooms} rooms")

    if not build.done and build.run(sessions(corpus), partial(make_session, corpus, build.work), nj=nj):
        build.finish(assemble)


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and make the corpus; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out_dir", type=Path, metavar="OUT_DIR")
    parser.add_argument("--rooms", type=int, default=9, help=f"rooms, 1 to {MAX_ROOMS}; default 9")
    parser.add_argument("--mics", type=int, default=6, help="microphones per room, 1 to 31; default 6")
    parser.add_argument("--speakers", type=int, default=6, help="loudspeaker positions per room, 1 to 20; default 6")
    parser.add_argument("--silence-s", type=int, default=10, help="length of noise files [s], 1 to 60; default 10")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers; default 0")
    parser.add_argument("--nj", type=int, default=1, help="processes, at least 1; default 1")
    args = vars(parser.parse_args(argv))
    for key, highest in (("rooms", MAX_ROOMS), ("mics", 31), ("speakers", 20), ("silence_s", 60), ("nj", 1000)):
        if not 1 <= args[key] <= highest:
            parser.error(f"--{key.replace('_', '-')} {args[key]} must lie in 1 to {highest}")
    out_dir, nj = args.pop("out_dir"), args.pop("nj")
    try:
        make_synthetic_rirs(out_dir, Corpus(**args), nj)
    except (ValueError, OSError) as error:
        print(f"make_synthetic_rirs.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
