"""What an effect is: physics that the simulator lacks until a model switches it on.

An effect is a frozen dataclass of the parameters of one unit (a loudspeaker, a microphone, a room, or all). It acts at
the place where its physics does:

`on_scene`
    geometry and air, before paths are looked at
`on_paths`
    energy of the paths by their angle of departure
`on_rir`
    what is filtered or added behind the rendering

and, for the loop, on tables of expected energy (`apply_to_prediction`), which says the same without rendering. To be
fitted, an effect turns into a vector of numbers of about unit spread (`vector`, `from_vector`) that `STARTS` and
`SPREAD` speak of.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used

from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.sim.render import render


@dataclass(frozen=True)
class ModelAir:
    """Air whose speed of sound and absorption are given apart; see `roomeq.sim.scene.Air`."""

    speed_m_s: float
    attenuation_per_m: np.ndarray


@dataclass(frozen=True)
class Rendering:
    """What an effect may know of the RIR that it changes.

    Attributes
    ----------
    scene : roomeq.sim.scene.Scene
    source_pos_m, mic_pos_m : tuple of 3 floats
    direct_gain : ndarray, shape (8,)
        Pressure of the direct sound, ``1 / (4 pi r)`` less air; 0 where it is obstructed.
    t60_s : ndarray, shape (8,)
        Decay time of the scene.
    rng : numpy.random.Generator
    white : ndarray, shape (8,)
        White noise of the recording that it is compared with: energy of 100 ms relative to the response; 0 if none is.
    """

    scene: object
    source_pos_m: tuple
    mic_pos_m: tuple
    direct_gain: np.ndarray
    t60_s: np.ndarray
    rng: np.random.Generator
    white: np.ndarray

    @property
    def distance_m(self):
        return float(np.linalg.norm(np.subtract(self.mic_pos_m, self.source_pos_m)))

    def direct(self, n_samples):
        """The direct sound as the simulator rendered it."""
        return self._rendered(self.distance_m, self.direct_gain, n_samples)

    def pulse(self, length_m, gains, n_samples):
        """A single path of some length and pressure per band, shape (8,); minimum phase: nothing precedes it."""
        pulse = self._rendered(length_m, np.ones(len(gains)), n_samples)
        taps = minimum_phase(EXACT_BANDS_HZ, 20.0 * np.log10(np.maximum(gains, 1e-9)))
        return scipy.signal.oaconvolve(pulse, taps)[:n_samples]

    def _rendered(self, length_m, gains, n_samples):
        silence = np.zeros((1, len(gains)))
        return render(np.array([length_m]), np.asarray(gains, dtype=float)[None], silence, np.zeros(n_samples),
                      speed_m_s=self.scene.air.speed_m_s, n_samples=n_samples)


class Effect:
    """Base of all effects: changes nothing.

    Class attributes
    ----------------
    NAME : str
    SCOPE : str
        What has parameters of its own: ``"all"``, ``"source"``, ``"mic"``, ``"room"`` or ``"rir"``.
    STARTS : tuple of tuples
        Vectors from which a fit starts.
    SPREAD : tuple
        Standard deviations of the vector over the things that exist.
    DISCRIMINATING_MEASUREMENT : str
        Which measurement would tell it from others.
    INTERPOLATION_GRID : tuple of tuples
        Vectors at which `apply_to_prediction` needs the rendered change of the data's RIRs
        (`Data.rendered_change_of`).
    REFLECTIONS : bool
        Whether `apply_to_prediction` changes the energy of reflections; if not, a fit need not sum it again.
    """

    NAME = ""
    SCOPE = "all"
    STARTS = ((),)
    SPREAD = ()
    DISCRIMINATING_MEASUREMENT = ""
    INTERPOLATION_GRID = ()
    REFLECTIONS = True

    @classmethod
    def prior_covariance(cls):
        """Covariance of the vector before anything was measured, shape (n, n)."""
        return np.diag(np.square(np.asarray(cls.SPREAD, dtype=float)))

    @classmethod
    def applies(cls, data):
        """Whether the rows state what the effect needs to know."""
        return True

    def vector(self):
        raise NotImplementedError

    @classmethod
    def from_vector(cls, vector):
        raise NotImplementedError

    def apply_to_prediction(self, state, data, rows):
        """Change what is expected of some RIRs (`roomeq.loop.predict.State`), in place."""

    def on_scene(self, scene):
        return scene

    def on_paths(self, cos_angle):
        """Energy gain of paths over the cosine of their angle of departure, shape (..., 8), or None for 1."""
        return None

    def on_rir(self, rir, rendering):
        return rir


def minimum_phase(frequencies_hz, gains_db, n_taps=2048):
    """Causal filter of a magnitude, interpolated in dB over log frequency; minimum phase by the cepstrum.

    Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., sec. 13.3. Loudspeakers and microphones are close
    to minimum phase.

    Returns
    -------
    taps : ndarray, shape (n_taps // 2,)
    """
    frequency = np.fft.rfftfreq(n_taps, 1.0 / FS_HZ)
    log_gain = np.interp(np.log(np.maximum(frequency, 1.0)), np.log(frequencies_hz), gains_db) * np.log(10.0) / 20.0
    cepstrum = np.fft.irfft(log_gain, n_taps)
    cepstrum[1:n_taps // 2] *= 2.0
    cepstrum[n_taps // 2 + 1:] = 0.0
    return np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), n_taps)[:n_taps // 2]
