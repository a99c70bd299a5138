"""Audio players of a page: the response itself, and a dry signal heard through it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy  # its submodules load themselves when first used

from roomeq.acoustics.direct import find_direct
from roomeq.augment.mix import without_rumble
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import audio_info, read_audio, sounds
from roomeq.core.rng import rng_for
from roomeq.report.formats import flac_uri

MAX_SPEECH_S = 8.0
MAX_RESPONSE_S = 3.0
_PEAK = 0.9
_BURST_S, _BURSTS, _PAUSE_S = 0.12, 3, 0.6
_FADE_S = 5e-3
LEAD_S = 0.02
"""What is played of an RIR before its direct sound [s]."""
_CUT_FADE_S = 0.1


@dataclass(frozen=True)
class Clip:
    """A sound to play.

    Attributes
    ----------
    ident, label : str
        Id of the element, and what is heard.
    colour : str
        Name of the colour of the kind of RIR.
    src : str
        Audio as a ``data:`` URI.
    """

    ident: str
    label: str
    colour: str
    src: str


def dry_signal(speech: Path | None, fs_hz: int) -> tuple[str, FloatArray]:
    """Return the name and the samples of the dry signal: a recording from its first sound on, or bursts of pink noise.

    The recording has no rumble, which counts as energy and which simulated RIRs would raise.

    Raises
    ------
    ValueError
        The recording cannot be read, or is silent.
    """
    if speech is None:
        return "noise bursts", _noise_bursts(fs_hz)
    rate_hz = audio_info(speech).samplerate
    samples = np.trim_zeros(read_audio(speech, fs_hz=rate_hz), "f")[:round(MAX_SPEECH_S * rate_hz)]
    if not len(samples) or not sounds(samples):
        raise ValueError(f"{speech}: silent (all samples the same): give another recording of dry speech")
    samples = without_rumble(samples, rate_hz)
    if rate_hz != fs_hz:
        import soxr

        samples = soxr.resample(samples, rate_hz, fs_hz, quality="VHQ")
    return "speech", samples


def clips(rirs: Sequence[tuple[str, str, FloatArray, int]], speech: Path | None, *,
          with_responses: bool = True) -> list[Clip]:
    """Return the players of some RIRs: the dry signal and it through each RIR, of equal energy, and each RIR.

    RIRs are played from shortly before the direct sound on, for `MAX_RESPONSE_S` at most.

    Parameters
    ----------
    rirs : sequence of (label, colour, samples, fs_hz)
    speech : Path, optional
        Recording of dry speech.
    with_responses : bool
        Whether the RIRs themselves are played too.
    """
    made = []
    signals: list[tuple[str, str, str, FloatArray, int]] = []
    name, dry = dry_signal(speech, rirs[0][3])
    signals.append(("dry", f"{name}, dry", "clean", dry, rirs[0][3]))
    for number, (label, colour, samples, fs_hz) in enumerate(rirs, start=1):
        _, dry = dry_signal(speech, fs_hz)
        heard = scipy.signal.oaconvolve(dry, _played(samples, fs_hz))
        signals.append((f"through-{number}", f"{name}, {label}", colour, heard, fs_hz))
    for ident, label, colour, samples, fs_hz in _equally_loud(signals):
        made.append(Clip(f"audio-{ident}", label, colour, flac_uri(samples, fs_hz)))
    for number, (label, colour, samples, fs_hz) in enumerate(rirs if with_responses else (), start=1):
        response = _played(samples, fs_hz)
        made.append(Clip(f"audio-rir-{number}", f"impulse response, {label}", colour,
                         flac_uri(_PEAK * response / np.abs(response).max(), fs_hz)))
    return made


def _played(samples: FloatArray, fs_hz: int) -> FloatArray:
    """Return the part of an RIR that is played; where it is cut off, it fades out."""
    try:
        direct = find_direct(samples, fs_hz).sample
    except ValueError:  # it is shown although it is no RIR
        direct = float(np.argmax(np.abs(samples)))
    start, n_samples = max(0, round(direct - LEAD_S * fs_hz)), round(MAX_RESPONSE_S * fs_hz)
    part = samples[start:start + n_samples]
    if start + n_samples < len(samples):
        n_fade = round(_CUT_FADE_S * fs_hz)
        part = part * np.minimum(1.0, np.arange(n_samples, 0, -1) / n_fade)
    return part


def _equally_loud(signals: Sequence[tuple[str, str, str, FloatArray, int]]
                  ) -> list[tuple[str, str, str, FloatArray, int]]:
    """Scale signals to the same energy per second of dry sound; the largest peak of all is `_PEAK`."""
    scaled = [(ident, label, colour, samples / np.sqrt(np.sum(samples ** 2) / fs_hz), fs_hz)
              for ident, label, colour, samples, fs_hz in signals]
    peak = max(float(np.abs(samples).max()) for *_, samples, _ in scaled)
    return [(ident, label, colour, _PEAK * samples / peak, fs_hz) for ident, label, colour, samples, fs_hz in scaled]


def _noise_bursts(fs_hz: int) -> FloatArray:
    """Return bursts of pink noise from 100 Hz on with pauses, in which the decay is heard."""
    n_burst = round(_BURST_S * fs_hz)
    rng = rng_for(0, "noise bursts to listen to", "")
    spectrum = np.fft.rfft(rng.standard_normal(n_burst))
    frequencies_hz = np.fft.rfftfreq(n_burst, 1.0 / fs_hz)
    spectrum *= np.where(frequencies_hz >= 100.0, 1.0 / np.sqrt(np.maximum(frequencies_hz, 100.0)), 0.0)
    burst = np.fft.irfft(spectrum, n_burst)
    n_fade = round(_FADE_S * fs_hz)
    fade = np.sin(0.5 * np.pi * (np.arange(n_fade) + 0.5) / n_fade) ** 2
    burst[:n_fade] *= fade
    burst[-n_fade:] *= fade[::-1]
    period = np.concatenate([burst, np.zeros(round(_PAUSE_S * fs_hz))])
    return np.asarray(np.tile(period, _BURSTS))
