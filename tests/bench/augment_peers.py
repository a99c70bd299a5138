"""What others have for the same work as `roomeq augment`: Kaldi's wav-reverberate, lhotse, audiomentations.

Each takes tasks that were drawn before, and does what its users do, from one FLAC file to another, at our level of
compression. All are optional: see `README.md`.
"""

import importlib
import os
import random
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from roomeq.augment.pack import FLAC_LEVEL

FS = 16000


@dataclass(frozen=True)
class Task:
    """One utterance to make.

    Attributes
    ----------
    clean, rir, out : Path
        FLAC, 16-bit WAV at full scale, FLAC.
    noise : Path or None
        16-bit WAV, at least as long as the utterance.
    snr_db : float
    n_samples : int
    """

    clean: Path
    rir: Path
    out: Path
    n_samples: int
    noise: Path | None = None
    snr_db: float = 0.0


class Kaldi:
    """`flac -d | wav-reverberate | flac`, as in the `wav.scp` that stock `reverberate_data_dir.py` writes."""

    def __init__(self, tasks):
        root = os.environ.get("KALDI_ROOT")
        self.binary = Path(root or "/nonexistent") / "src/featbin/wav-reverberate"
        if not self.binary.is_file():
            raise ImportError("KALDI_ROOT names no Kaldi with src/featbin/wav-reverberate")

    def make(self, task):
        """Reverberate one utterance; add its noise from the beginning to the end."""
        noise = [] if task.noise is None else [
            f"--duration={task.n_samples / FS:.7f}", f"--additive-signals={task.noise}", f"--snrs={task.snr_db}",
            "--start-times=0"]
        with subprocess.Popen(["flac", "-c", "-d", "-s", task.clean], stdout=subprocess.PIPE) as decode:
            with subprocess.Popen([self.binary, "--shift-output=true", f"--impulse-response={task.rir}", *noise,
                                   "-", "-"], stdin=decode.stdout, stdout=subprocess.PIPE,
                                  stderr=subprocess.DEVNULL) as reverberate:
                subprocess.run(["flac", f"-{8 * FLAC_LEVEL:.0f}", "-s", "-f", "-o", task.out, "-"],
                               stdin=reverberate.stdout, check=True)


class Lhotse:
    """`cut.reverb_rir(...).mix(...)`; manifests are made before time counts."""

    def __init__(self, tasks):
        lhotse = importlib.import_module("lhotse")
        importlib.import_module("torch").set_num_threads(1)
        paths = {path for task in tasks for path in (task.clean, task.rir, task.noise) if path}
        self.recordings = {path: lhotse.Recording.from_file(path) for path in paths}

    def make(self, task):
        """Reverberate one utterance and add the first part of its noise."""
        cut = self.recordings[task.clean].to_cut().reverb_rir(self.recordings[task.rir])
        if task.noise is not None:
            noise = self.recordings[task.noise].to_cut().truncate(duration=cut.duration)
            cut = cut.mix(noise, snr=task.snr_db)
        soundfile.write(task.out, cut.load_audio()[0], FS, compression_level=FLAC_LEVEL)


class Audiomentations:
    """`Compose([ApplyImpulseResponse, AddBackgroundNoise])`, held to the RIR, the noise and the SNR of the task."""

    def __init__(self, tasks):
        package = importlib.import_module("audiomentations")
        random.seed(0)  # where in a noise it begins
        self.reverberate = package.ApplyImpulseResponse(sorted({task.rir for task in tasks}), p=1.0)
        noises = {task.noise for task in tasks if task.noise}
        self.noises = {noise: package.AddBackgroundNoise(noise, p=1.0) for noise in noises}

    def make(self, task):
        """Reverberate one utterance, which it leaves as late as the RIR makes it."""
        samples, _ = soundfile.read(task.clean, dtype="float32")
        self.reverberate.parameters = dict(should_apply=True, ir_file_path=str(task.rir))
        self.reverberate.freeze_parameters()
        samples = self.reverberate(samples, FS)
        if task.noise is not None:
            add = self.noises[task.noise]
            add.min_snr_db = add.max_snr_db = task.snr_db
            samples = add(samples, FS)
        soundfile.write(task.out, samples, FS, compression_level=FLAC_LEVEL)


def convolve_as_kaldi(x, h):
    """Return x*h as `wav-reverberate` computes it, in float64.

    Its FFT packs the real bins at 0 Hz and at half the sample rate into one complex number, and
    `ElementwiseProductOfFft` (feat/signal.cc) multiplies that as if it were one: each block of the result gets an
    offset and an alternating sequence that do not belong there.
    """
    n_fft = 1 << (4 * len(h) - 1).bit_length()
    hop = n_fft - len(h) + 1
    response, y = np.fft.rfft(h, n_fft), np.zeros(len(x) + hop + n_fft)
    for start in range(0, len(x), hop):
        block = np.fft.rfft(x[start:start + hop], n_fft)
        product = block * response
        packed = (block[0].real + 1j * block[-1].real) * (response[0].real + 1j * response[-1].real)
        product[0], product[-1] = packed.real, packed.imag
        y[start:start + n_fft] += np.fft.irfft(product, n_fft)
    return y[:len(x) + len(h) - 1]


PEERS = dict(wav_reverberate=Kaldi, lhotse=Lhotse, audiomentations=Audiomentations)


def present(tasks):
    """Return those that are here by name, and a line for each that isn't."""
    here, absent = {}, []
    for name, peer in PEERS.items():
        try:
            here[name] = peer(tasks)
        except ImportError as error:
            absent.append(f"{name} is left out: {error}")
    return here, absent
