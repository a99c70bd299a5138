"""The catalogue of effects, by name."""

from roomeq.effects.air_absorption import AirAbsorption
from roomeq.effects.base import Effect
from roomeq.effects.coupled_volume import CoupledVolume
from roomeq.effects.mic_response import MicResponse
from roomeq.effects.near_reflector import NearReflector
from roomeq.effects.noise_floor import NoiseFloor
from roomeq.effects.occlusion import Occlusion
from roomeq.effects.room_eq import RoomEq
from roomeq.effects.room_modes import RoomModes
from roomeq.effects.sound_speed import SoundSpeed
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.effects.source_response import SourceResponse

_EFFECTS: tuple[type[Effect], ...] = (
    AirAbsorption, SoundSpeed, SourceDirectivity, RoomModes, NearReflector, Occlusion, CoupledVolume, SourceResponse,
    MicResponse, RoomEq, NoiseFloor)

CATALOGUE: dict[str, type[Effect]] = {effect.NAME: effect for effect in _EFFECTS}
"""Effects by name, in the order in which a model applies them: sound field, recording chain, noise. The wave field of a
room replaces rays at low frequencies, and comes before what is added to its sound. An obstacle shades the reflection of
a desk as it shades others."""
