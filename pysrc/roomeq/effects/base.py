"""The interface of an effect: physics that the simulator lacks until a model switches it on.

Conventions
-----------
An effect is a frozen dataclass that holds the parameters of one unit (a loudspeaker, a microphone, a room, an RIR, or
all recordings). Its physics - gain, delay and added energy over band, angle, time and distance - is stated once, by
methods of its own or by `changed_air` and `on_paths`. The hooks of the renderer and the prediction of the loop both
call these methods:

`on_scene`
    changes geometry or air before paths are traced
`on_paths`
    energy gain of paths over their angle of departure
`on_rir`
    filters the rendered RIR or adds to it
`apply_to_prediction`
    changes the predicted energies of the loop (`roomeq.effects.prediction`), without rendering

For a fit, an effect is a vector of numbers with a spread of about one (`vector`, `from_vector`); `STARTS` and `SPREAD`
refer to this vector. `tests/integration/test_effects_contract.py` checks that the predicted change equals the rendered
change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.band_energy import OCTAVES, energy_in_bands, energy_per_bin
from roomeq.acoustics.octaves import octave_fft_size
from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.sim.render import render, tail_noise
from roomeq.sim.scene import Air, Scene


@dataclass(frozen=True)
class ModelAir:
    """Air whose speed of sound and absorption are independent of each other; see `roomeq.sim.scene.Air`.

    Attributes
    ----------
    speed_m_s : float or ndarray, shape (n,)
    attenuation_per_m : ndarray, shape (8,) or (n, 8)
        Energy attenuation per octave band [1/m].
    """

    speed_m_s: float | FloatArray
    attenuation_per_m: FloatArray


@dataclass(frozen=True)
class Rendering:
    """The context of a rendered RIR that `on_rir` may use.

    Attributes
    ----------
    scene : roomeq.sim.scene.Scene
    source_pos_m, mic_pos_m : tuple of 3 floats
    direct_gain : ndarray, shape (8,)
        Pressure of the direct sound, ``1 / (4 pi r)`` with air absorption; 0 where it is obstructed.
    t60_s : ndarray, shape (8,)
        Decay time of the scene.
    rng : numpy.random.Generator
    rendered : ndarray, shape (n_samples,)
        The RIR before all effects that act on it as a whole.
    white : ndarray, shape (8,)
        White noise of the recording that the RIR is compared with: energy of 100 ms relative to the response; 0 if
        there is none.
    diffuse_noise : callable, optional
        From a number of samples to noise with the coherence of a diffuse field; for a microphone of an array.
    """

    scene: Scene
    source_pos_m: Sequence[float]
    mic_pos_m: Sequence[float]
    direct_gain: FloatArray
    t60_s: FloatArray
    rng: np.random.Generator
    rendered: FloatArray
    white: FloatArray
    diffuse_noise: Callable[[int], Array] | None = None

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(np.subtract(self.mic_pos_m, self.source_pos_m)))

    def tail_noise(self, n_samples: int) -> Array:
        """Return noise of late reverberation, of unit mean power (`roomeq.sim.render.tail_noise`)."""
        if self.diffuse_noise is not None:
            return self.diffuse_noise(n_samples)
        return tail_noise(n_samples, self.scene.room.volume_m3, self.scene.air.speed_m_s, self.rng)

    def direct(self, n_samples: int) -> FloatArray:
        """Return the direct sound as the simulator rendered it."""
        return self.pulse(self.distance_m, self.direct_gain, n_samples)

    def pulse(self, length_m: float, gains: ArrayLike, n_samples: int) -> FloatArray:
        """Render a single path with a pressure gain per band, shape (8,), in minimum phase: nothing precedes it."""
        gains = np.asarray(gains, dtype=float)
        silence = np.zeros((1, len(gains)))
        return render(np.array([length_m]), gains[None], silence, np.zeros(n_samples),
                      speed_m_s=self.scene.air.speed_m_s, n_samples=n_samples)


class Effect:
    """Base class of all effects; changes nothing.

    Class attributes
    ----------------
    NAME : str
    SCOPE : str
        The unit that has parameters of its own: ``"all"``, ``"source"``, ``"mic"``, ``"room"`` or ``"rir"``.
    STARTS : tuple of tuples
        Vectors from which a fit starts.
    SPREAD : tuple
        Standard deviations of the vector over real units.
    BANDS : tuple
        Octave that each component of the vector changes, None where it changes several; empty if all do.
    DISCRIMINATING_MEASUREMENT : str
        A measurement that would distinguish the effect from others.
    INTERPOLATION_GRID : tuple of tuples
        Vectors at which `apply_to_prediction` needs the rendered change of the data's RIRs
        (`PredictedRirs.rendered_change_of`); empty where the prediction follows from the parameters.
    REFLECTIONS : bool
        Whether `apply_to_prediction` changes the energy of reflections; if not, a fit reuses the sum over them.
    MEASURED : bool
        Whether the vector can be read off the recordings (`measured_vectors`), whatever their rows say of the room.
    IN_RESPONSE : bool
        Whether it is a part of the room impulse response. Noise of a recording is none: `roomeq simulate` leaves it
        out.
    NAMES_CAUSE : bool
        Whether it is a physical cause. An equaliser is none: whatever explains as much comes first.
    """

    NAME: ClassVar[str] = ""
    SCOPE: ClassVar[str] = "all"
    STARTS: ClassVar[tuple[tuple[float, ...], ...]] = ((),)
    SPREAD: ClassVar[tuple[float, ...]] = ()
    BANDS: ClassVar[tuple[int | None, ...]] = ()
    DISCRIMINATING_MEASUREMENT: ClassVar[str] = ""
    INTERPOLATION_GRID: ClassVar[tuple[tuple[float, ...], ...]] = ()
    REFLECTIONS: ClassVar[bool] = True
    MEASURED: ClassVar[bool] = False
    IN_RESPONSE: ClassVar[bool] = True
    NAMES_CAUSE: ClassVar[bool] = True

    @classmethod
    def prior_covariance(cls) -> FloatArray:
        """Return the prior covariance of the vector, shape (n, n)."""
        return np.diag(np.square(np.asarray(cls.SPREAD, dtype=float)))

    @classmethod
    def applies(cls, data: PredictedRirs) -> bool:
        """Tell whether the rows state what the effect needs to know."""
        return True

    @classmethod
    def measured_vectors(cls, data: PredictedRirs) -> FloatArray | None:
        """Return each room's vector as far as it can be read off the recordings, shape (n_rooms, n).

        None unless `MEASURED`. A fit starts there instead of at `STARTS`.
        """
        return None

    def vector(self) -> FloatArray:
        """Return the parameters as a vector, shape (n,)."""
        raise NotImplementedError

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        """Return the effect with the parameters of a vector, shape (n,), limited to their ranges."""
        raise NotImplementedError

    def changed_air(self, air: Air | ModelAir) -> Air | ModelAir:
        """Return the air with the effect; the same object where the effect leaves air alone."""
        return air

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        """Change the predicted energies of some RIRs, in place.

        Parameters
        ----------
        state : PredictionState
        data : PredictedRirs
        rows : ndarray of int
            The RIRs of the effect's unit.
        """
        before = ModelAir(state.speed_m_s[rows], state.air_per_m[rows])
        air = self.changed_air(before)
        if air is not before:
            state.speed_m_s[rows], state.air_per_m[rows] = air.speed_m_s, air.attenuation_per_m

    def on_scene(self, scene: Scene) -> Scene:
        """Return the scene with the effect."""
        air = self.changed_air(scene.air)
        return scene if air is scene.air else replace(scene, air=cast(Air, air))  # all that is read of an Air

    def on_paths(self, cos_angle: FloatArray) -> FloatArray | None:
        """Return the energy gain of paths over the cosine of their angle of departure, shape (..., 8).

        The angle is that between a path's departure and the direction that the source faces. None, for a gain of 1, in
        this class alone: an effect that overrides it acts on all paths.
        """
        return None

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        """Return the rendered RIR, shape (n_samples,), with the effect; it may become longer."""
        return rir


def correlation_of_bands(n_bands: int, length: float) -> FloatArray:
    """Return correlations that fall with the distance of two bands, ``exp(-(distance / length)^2 / 2)``, (n, n)."""
    distance = np.subtract.outer(np.arange(n_bands), np.arange(n_bands))
    return np.exp(-0.5 * (distance / length) ** 2)


def octave_energies(rir: Array) -> FloatArray:
    """Return the energy of a response in each octave band, shape (8,)."""
    n_fft = octave_fft_size(len(rir), FS_HZ)
    return energy_in_bands(OCTAVES, energy_per_bin(rir, n_fft), n_fft)
