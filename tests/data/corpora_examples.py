"""Tiny synthetic corpora of every kind, written where a test needs them."""

import numpy as np
import soundfile

from roomeq.core.rng import rng_for

FS_HZ = 16000
SWEEP = "IR_sweep_15s_45Hzto22kHz_FS16kHz"
BANNER = "########\n# ENVIRONMENT\n########\n"


def rir(name="rir", n=800, channels=1):
    """A decaying noise with a direct sound, shape (n,) or (n, channels)."""
    samples = rng_for(0, "test rir", name).normal(size=(n, channels)) * np.exp(-np.arange(n) / 100)[:, None] * 0.01
    samples[40] = 0.5
    return samples[:, 0] if channels == 1 else samples


def put(path, samples=None, fs_hz=FS_HZ, subtype="PCM_16"):
    """Write an audio file, folders included."""
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, rir(path.name) if samples is None else samples, fs_hz, subtype=subtype)
    return path


def put_text(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def meta_text(**keys):
    return BANNER + "".join(f"${key}\t{value}\n" for key, value in keys.items() if value is not None)


def put_reverbdb_mic(session, n, mic_m=(1.747, 4.123, 1.229), takes=("v00",), silences=(), **keys):
    """One microphone folder of a session, its meta file as released (`keys` add to or replace it)."""
    folder = session / f"{n:02d}"
    meta = {"EnvMicID": n, f"EnvMic{n}TypeID": f"01-{n}"}
    meta |= dict(zip((f"EnvMic{n}{axis}" for axis in ("Depth", "Width", "Height")), mic_m, strict=True))
    meta |= {f"EnvMic{n}RelRT60": 0.61} | keys
    put_text(folder / "mic_meta.txt", meta_text(**meta))
    for take in takes:
        put(folder / "RIR" / f"{SWEEP}.{take}.wav", rir(str(session.name + take) + str(n)))
    for name in silences:
        put(folder / "silence" / f"{name}.wav", rir(name) * 0.01)
    return folder


def put_reverbdb_session(room, name="SpkID01_20190503_S", speaker_m=(0.988, 4.527, 1.459)):
    axes = ("Depth", "Width", "Height")
    put_text(room / "MicID01" / name / "spk_meta.txt",
             meta_text(**dict(zip((f"EnvSpk1{axis}" for axis in axes), speaker_m, strict=True))))
    return room / "MicID01" / name


def put_reverbdb_room(root, name="VUT_FIT_Q301", env="env_meta.txt", **keys):
    meta = dict(EnvType="office", EnvDepth=10.776, EnvWidth=6.94, EnvHeight=2.598, EnvTemp=22.5) | keys
    put_text(root / name / env, meta_text(**meta))
    return root / name


def make_reverbdb(root):
    session = put_reverbdb_session(put_reverbdb_room(root))
    put_reverbdb_mic(session, 1, silences=("a.v00", "b.v00"), EnvMic1RelDistance=0.89)
    put_reverbdb_mic(session, 2, (3.0, 2.0, 1.2))
    return root


def make_table(root):
    put(root / "rirs" / "lab" / "one.flac")
    put(root / "rirs" / "lab" / "two_clap.flac")
    put_text(root / "manifest.csv",
             "file,rir_id,dataset,room,source_id,mic_id,binaural,distance_m,room_dims_m,source_pos_m,mic_pos_m\n"
             "rirs/lab/one.flac,lab__one,Lab,lab,ls,mic,0,1.50,9.7 5.5 2.7,4.71 2.75 ?,6.21 2.75 ?\n"
             "rirs/lab/two_clap.flac,lab__two_clap,Lab,lab,ls,mic,1,,,,\n")
    return root


def make_folder(root):
    put(root / "kitchen" / "near.wav")
    put(root / "kitchen" / "far stereo.wav", rir("stereo", channels=2))
    put(root / "hall" / "hall_44k.wav", rir("44k", 2000), fs_hz=44100, subtype="FLOAT")
    return root


def make_slr28(root):
    real = root / "RIRS_NOISES" / "real_rirs_isotropic_noises"
    names = {"RVB2014_type1_rir_largeroom1_near_angla": 8, "RWCP_type4_rir_p30l": 1,
             "air_type1_air_binaural_lecture_1_2": 2, "air_type1_air_phone_stairway_hhp": 2}
    for name, channels in names.items():
        put(real / f"{name}.wav", rir(name, 400, channels))
    put(real / "RVB2014_type1_noise_largeroom1_1.wav", rir("noise", 1600, 8))
    put(real.parent / "pointsource_noises" / "noise-free-sound-0000.wav")
    put(real.parent / "simulated_rirs" / "smallroom" / "Room001" / "Room001-00001.wav")
    put_text(real / "rir_list", "".join(
        f"--rir-id {n} --room-id r{n} RIRS_NOISES/real_rirs_isotropic_noises/{name}.wav\n" for n, name in
        enumerate(names)))
    put_text(real / "noise_list", "--noise-id 1 --noise-type isotropic --room-linkage x "
             "RIRS_NOISES/real_rirs_isotropic_noises/RVB2014_type1_noise_largeroom1_1.wav\n")
    return root


def put_sofa(path, n_measurements=1, n_receivers=1, fs_hz=48000, convention="SingleRoomSRIR", **values):
    """Write a SOFA file; positions default to a source at 1, 1, 1.2 m and a listener at 3, 2, 1.5 m of 5x4x3 m."""
    import warnings

    import sofar

    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = sofar.Sofa(convention)
        for name in ("ReceiverDescriptions", "EmitterDescriptions"):
            if hasattr(sofa, name):
                sofa.delete(name)
        m, r = n_measurements, n_receivers
        filled = dict(Data_IR=np.stack([[rir(f"{i}-{j}", 2400) for j in range(r)] for i in range(m)]),
                      Data_SamplingRate=fs_hz, Data_Delay=np.zeros((1, r)),
                      SourcePosition=np.tile([1.0, 1.0, 1.2], (m, 1)), SourcePosition_Type="cartesian",
                      SourcePosition_Units="metre", ListenerPosition=np.tile([3.0, 2.0, 1.5], (m, 1)),
                      ReceiverPosition=np.zeros((r, 3)))
        for who in ("Source", "Listener"):
            filled[f"{who}View"], filled[f"{who}Up"] = np.tile([1, 0, 0], (m, 1)), np.tile([0, 0, 1], (m, 1))
        if convention == "SingleRoomSRIR":
            filled |= dict(RoomCornerA=[[0, 0, 0]], RoomCornerB=[[5, 4, 3]], MeasurementDate=np.zeros(m),
                           ReceiverView=np.tile([[[1], [0], [0]]], (r, 1, 1)),
                           ReceiverUp=np.tile([[[0], [0], [1]]], (r, 1, 1)))
        for key, value in (filled | values).items():
            if hasattr(sofa, key):
                setattr(sofa, key, value)
        sofar.write_sofa(str(path), sofa)
    return path


def make_sofa(root):
    put_sofa(root / "room_a.sofa", n_measurements=2, n_receivers=2, GLOBAL_RoomShortName="room a")
    put_sofa(root / "b" / "plain.sofa", convention="GeneralFIR", fs_hz=16000)
    return root


MEASURED = dict(reverbdb=make_reverbdb, table=make_table, folder=make_folder, slr28=make_slr28, sofa=make_sofa)


def put_librispeech(root, sets, speakers="; a comment\n"):
    """A LibriSpeech tree: `sets` is {set: {reader: {chapter: number of utterances}}}."""
    for name, readers in sets.items():
        for reader, chapters in readers.items():
            gender = "F" if int(reader) % 2 else "M"
            # one name of the real file holds bars
            speakers += f"{reader:<5}| {gender} | {name:<16} | 8.04 | |CBW|Simon\n"
            for chapter, count in chapters.items():
                folder = root / name / reader / chapter
                ids = [f"{reader}-{chapter}-{n:04d}" for n in range(count)]
                for n, utt in enumerate(ids):
                    put(folder / f"{utt}.flac", rir(utt, 1600 + n))
                put_text(folder / f"{reader}-{chapter}.trans.txt", "".join(f"{utt} SOME WORDS\n" for utt in ids))
    put_text(root / "SPEAKERS.TXT", speakers)
    return root
