"""Broken audio, wherever audio is read."""

import struct

import numpy as np
from wrong import Case, audio, cut, patch, remove, write

WAV = "measured/audio/r0.wav"
CHARACTERISE = "characterise measured out"
AUGMENT = "augment speech rirs out"
READ = "read-measured folder out"
ONES = np.ones(9920)
NAN = np.where(np.arange(9920) == 99, np.nan, 0.1)


def _flac_that_promises(n_samples: int) -> bytes:
    """Return a FLAC file whose header promises samples that are not there."""
    info = struct.pack(">HH", 4096, 4096) + bytes(6) + struct.pack(">Q", 16000 << 44 | 15 << 36 | n_samples)
    return b"fLaC\x80\0\0\x22" + info + bytes(16)


def _wav(n_channels: int = 1, fs_hz: int = 16000, data: bytes = bytes(800), claimed: int | None = None) -> bytes:
    """Return a 16-bit WAV file with a header of our choice."""
    claimed = len(data) if claimed is None else claimed
    head = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, n_channels, fs_hz, 2 * n_channels * fs_hz % 2**32,
                       2 * n_channels % 2**16, 16)
    return struct.pack("<4sI", b"RIFF", 4 + len(head) + 8 + claimed) + b"WAVE" + head + struct.pack(
        "<4sI", b"data", claimed) + data


CASES = [
    Case("missing", CHARACTERISE, "measured/audio/r0.wav: no such audio file: check the path", (remove(WAV),)),
    Case("far beyond full scale", CHARACTERISE, "measured/audio/r0.wav: peak 1e+20 must be at most 1e+10: convert it "
         "again, full scale being 1", (audio(WAV, 1e20 * ONES, subtype="FLOAT"),)),
    Case("far beyond double scale", READ, "folder/kitchen/near.wav: peak 1e+300 must be at most 1e+10: convert it "
         "again, full scale being 1 (or leave such files out with --skip-bad)",
         (audio("folder/kitchen/near.wav", 1e300 * ONES, subtype="DOUBLE"),)),
    Case("noise far beyond full scale", "read-noises noises out", "noises/click.wav: peak 1e+30 must be at most 1e+10: "
         "convert it again, full scale being 1 (or leave such files out with --skip-bad)",
         (audio("noises/click.wav", np.full(1600, 1e30), subtype="FLOAT"),)),
    Case("raw", "read-measured folder/kitchen/x.raw out", "folder/kitchen/x.raw: cannot be read as audio (...): "
         "convert it to WAV or FLAC (or leave such files out with --skip-bad)",
         (write("folder/kitchen/x.raw", bytes(4000)),)),
    Case("empty", CHARACTERISE, "measured/audio/r0.wav: audio file is empty (0 bytes): copy or record it again",
         (write(WAV, b""),)),
    Case("no audio", CHARACTERISE,
         "measured/audio/r0.wav: cannot be read as audio (...): convert it to WAV or FLAC",
         (write(WAV, "this is no audio"),)),
    Case("truncated wav", CHARACTERISE, "measured/audio/r0.wav: truncated: 19869 bytes of 39738: copy it again",
         (cut(WAV, 0.5),)),
    Case("no samples", CHARACTERISE, "measured/audio/r0.wav: holds 0 samples: copy or record it again",
         (audio(WAV, np.zeros(0)),)),
    Case("another length than the row", CHARACTERISE,
         "measured/audio/r0.wav: 4000 samples where rirs.jsonl says 9920: make it again", (audio(WAV, 4000),)),
    Case("8 kHz", CHARACTERISE,
         "measured/audio/r0.wav: sample rate 8000 Hz must be 16000 Hz: the missing band cannot be restored: "
         "record or convert it at that rate", (audio(WAV, 9920, 8000),)),
    Case("48 kHz in an rir directory", CHARACTERISE,
         "measured/audio/r0.wav: sample rate 48000 Hz must be 16000 Hz: convert it", (audio(WAV, 9920, 48000),)),
    Case("stereo", CHARACTERISE,
         "measured/audio/r0.wav: 2 channels where one is expected: choose one, or split the file",
         (audio(WAV, np.ones((9920, 2)) / 9),)),
    Case("nan", CHARACTERISE, "measured/audio/r0.wav: holds NaN or infinite samples: convert it again",
         (audio(WAV, NAN, subtype="FLOAT"),)),
    Case("infinite", CHARACTERISE, "measured/audio/r0.wav: holds NaN or infinite samples: convert it again",
         (audio(WAV, np.where(np.isnan(NAN), np.inf, 0.1), subtype="FLOAT"),)),
    Case("silent", CHARACTERISE,
         "measured/audio/r0.wav: RIR r0 is silent (all samples 0): leave it out or record it again",
         (audio(WAV, np.zeros(9920)),)),
    Case("no direct sound", "characterise --keep-suspicious measured out",
         "measured/audio/r0.wav: impulse response has no direct sound: its peak 0.1 must exceed 6 times its "
         "noise, 0.1: record it again", (audio(WAV, np.full(9920, 0.1)),)),
    Case("header promises 18 hours", CHARACTERISE,
         "measured/audio/r0.wav: 1073741824 samples in 1 channels must be at most 345600000 (6 h at 16000 Hz): "
         "split the file, or raise the bound with roomeq --max-audio-hours",
         (write(WAV, _flac_that_promises(2**30)),)),
    Case("header promises 49 days", CHARACTERISE,
         "measured/audio/r0.wav: 68719476735 samples in 1 channels must be at most 345600000 (6 h at 16000 "
         "Hz): split the file, or raise the bound with roomeq --max-audio-hours",
         (write(WAV, _flac_that_promises(2**36 - 1)),)),
    Case("65535 channels", CHARACTERISE,
         "measured/audio/r0.wav: cannot be read as audio (...): convert it to WAV or FLAC",
         (write(WAV, _wav(65535)),)),
    Case("2 GHz", READ,
         "folder/kitchen/near.wav: sample rate 2147483647 Hz must be at most 768000 Hz: correct the header (or "
         "leave such files out with --skip-bad)",
         (write("folder/kitchen/near.wav", _wav(fs_hz=2**31 - 1, data=b"\1\2" * 400)),)),
    Case("0 Hz", CHARACTERISE, "measured/audio/r0.wav: cannot be read as audio (...): convert it to WAV or FLAC",
         (write(WAV, _wav(fs_hz=0)),)),
    Case("a directory", CHARACTERISE, "measured/audio/r0.wav: no such audio file: check the path",
         (remove(WAV), write(f"{WAV}/x", ""))),
    Case("speech cut off", AUGMENT,
         "speech: utterance b-1-0001: speech/wav/b-1-0001.flac: broken audio (...): copy or record it again",
         (cut("speech/wav/b-1-0001.flac", 0.5),)),
    Case("speech empty", AUGMENT,
         "speech: utterance b-1-0001: speech/wav/b-1-0001.flac: audio file is empty (0 bytes): copy or record "
         "it again", (write("speech/wav/b-1-0001.flac", ""),)),
    Case("speech stereo", AUGMENT,
         "speech: utterance b-1-0001: speech/wav/b-1-0001.flac: 2 channels where one is expected: choose one, or "
         "split the file", (audio("speech/wav/b-1-0001.flac", np.ones((20011, 2)) / 9),)),
    Case("speech at 8 kHz", AUGMENT,
         "speech: utterance b-1-0001: speech/wav/b-1-0001.flac: sample rate 8000 Hz must be at least 16000 Hz: the "
         "missing band cannot be restored: record or convert it at that rate",
         (audio("speech/wav/b-1-0001.flac", 20011, 8000),)),
    Case("speech silent", AUGMENT,
         "speech: utterance b-1-0001 with RIR room1-2, noise hum-room1, noise tap: utterance is silent (all "
         "samples the same): leave it out of the data directory",
         (audio("speech/wav/b-1-0001.flac", np.zeros(20011)),)),
    Case("a frame overwritten", AUGMENT,
         "speech: utterance b-1-0001: speech/wav/b-1-0001.flac: broken audio (...): copy or record it again",
         (patch("speech/wav/b-1-0001.flac", -9000, b"garbage" * 200),)),
    Case("noise silent", "augment --point-snr none speech rirs out",
         "rirs/wav/hum-room0.flac: noise hum-room0 is silent (all samples the same): leave it out",
         tuple(audio(f"rirs/wav/hum-room{n}.flac", np.zeros(32000)) for n in (0, 1))),
    Case("noise at 8 kHz", "augment --point-snr none speech rirs out",
         "rirs/wav/hum-room0.flac: sample rate 8000 Hz must be at least 16000 Hz: the missing band cannot be restored: "
         "record or convert it at that rate",
         tuple(audio(f"rirs/wav/hum-room{n}.flac", 32000, 8000) for n in (0, 1))),
    Case("rir silent", AUGMENT,
         "rirs/wav/room0-0.wav: RIR room0-0 is silent (all samples 0): leave it out or record it again",
         tuple(audio(f"rirs/wav/room{r}-{n}.wav", np.zeros(4000)) for r in (0, 1) for n in (0, 1, 2))),
    Case("corpus file at 8 kHz", READ,
         "folder/kitchen/near.wav: sample rate 8000 Hz must be at least 16000 Hz: the missing band cannot be restored: "
         "record or convert it at that rate (or leave such files out with --skip-bad)",
         (audio("folder/kitchen/near.wav", 800, 8000),)),
    Case("corpus file of no audio", READ,
         "folder/kitchen/near.wav: cannot be read as audio (...): convert it to WAV or FLAC (or leave such "
         "files out with --skip-bad)", (write("folder/kitchen/near.wav", "MZ\x90\0"),)),
    Case("noise recording empty", "read-noises noises out",
         "noises/click.wav: audio file is empty (0 bytes): copy or record it again (or leave such files out "
         "with --skip-bad)", (write("noises/click.wav", ""),)),
    Case("simulated rir shorter than the analysis", "compensate measured eq out",
         "measured/audio/r0.wav: 800 samples where rirs.jsonl says 9920: make it again",
         (audio(WAV, 9920), write(WAV, _wav(data=bytes(1600))))),
    Case("rir nan in fit", "fit-eq --num-components 2 measured out",
         "measured/audio/r0.wav: holds NaN or infinite samples: convert it again",
         (audio(WAV, NAN, subtype="FLOAT"),)),
]
