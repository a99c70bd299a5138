"""Cut RIRs so that speech convolved with them stays aligned to its labels.

What the toolkits do about the delay of the direct sound:

ESPnet (`espnet2.train.preprocessor`), NeMo (`ImpulsePerturbation`)
    Nothing: the output is the first samples of the full convolution.
lhotse (`ReverbWithImpulseResponse`), as Kaldi's ``wav-reverberate --shift-output=true``
    They advance the output by the position of the largest sample, ``argmax(h)``. That is not the direct sound where its
    polarity is negative or a reflection is stronger.
"""

from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array

LEAD_S = 5e-3
"""Time from the start of an aligned RIR to its direct sound [s]: half a frame shift of common features. A compensation
filter of linear phase rings ahead of the direct sound, and without that part the EQ is another one."""
MAX_LATE_S = 0.01
"""Delay of the largest sample after the direct sound [s] up to which lhotse is taken to keep labels aligned: the frame
shift of common features."""


class AlignedRir(NamedTuple):
    """An RIR that begins `LEAD_S` before its direct sound.

    Attributes
    ----------
    samples : ndarray, shape (n_samples,)
    late_s : float
        Time from the direct sound to the largest sample [s], by which lhotse shifts speech too far.
    """

    samples: Array
    late_s: float


def align(rir: Array, direct: int, rate_hz: int, *, positive: bool) -> AlignedRir:
    """Cut or pad an RIR so that its direct sound comes `LEAD_S` after its first sample.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    direct : int
        Position of the direct sound [samples].
    rate_hz : int
        Sample rate [Hz].
    positive : bool
        Invert the RIR if its smallest sample is nearer to the direct sound than its largest one.
    """
    lead = round(LEAD_S * rate_hz)
    if positive and abs(int(np.argmin(rir)) - direct) < abs(int(np.argmax(rir)) - direct):
        rir = -rir
    samples = np.concatenate([np.zeros(max(0, lead - direct), rir.dtype), rir[max(0, direct - lead):]])
    return AlignedRir(samples, (int(np.argmax(samples)) - lead) / rate_hz)
