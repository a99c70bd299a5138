"""The table of effects: what is drawn for a room set, and what it does at a given scale.

Conventions
-----------
Each kind has ``draw(seed, rooms)``, which returns its parameters (JSON-able; nothing in it depends on the
strength), and ``extra(parameters, scale)``, which returns the `Extra` that does it. `scales` is the range that
physics allows; strength grows with it.

Every kind acts on every base (`testbed.bases`). On pyroomacoustics, whose rays know no screen in a shoebox, occlusion
changes its image sources alone; the directivity of a source weights them and, by the angle at which they left it, the
rays; another air or speed of sound is given to it.
"""

from collections.abc import Callable
from dataclasses import dataclass

from testbed import chain, fields, screen, waves
from testbed.size import JND


@dataclass(frozen=True)
class Kind:
    """One effect.

    Attributes
    ----------
    draw, extra : callable
        See the module.
    scales : tuple of float
        Smallest and largest scale.
    measured_by : tuple of str
        Cells whose mean change is its strength.
    probe_rooms : int
        Rooms that its scale is sought in; few where every scale takes long.
    """

    draw: Callable
    extra: Callable
    scales: tuple
    measured_by: tuple = tuple(JND)
    probe_rooms: int = 8


KINDS = {
    "air_absorption": Kind(fields.draw_air, fields.air, (0.02, 1.0)),
    "sound_speed": Kind(fields.draw_temperature, fields.temperature, (0.02, 1.0), ("arrival",)),
    "source_response": Kind(chain.draw_loudspeakers, chain.filtered_by("source_id"), (0.2, 20.0)),
    "mic_response": Kind(chain.draw_microphones, chain.filtered_by("mic_id"), (0.2, 20.0)),
    "source_directivity": Kind(fields.draw_directivity, fields.directivity, (0.02, 6.0)),
    "occlusion": Kind(screen.draw_screens, screen.occlusion, (0.25, 1.6), probe_rooms=3),
    "coupled_volume": Kind(fields.draw_coupled, fields.coupled, (0.02, 8.0)),
    "room_modes": Kind(waves.draw_modes, waves.modes, (45.0, 250.0)),
    "near_reflector": Kind(fields.draw_desk, fields.desk, (0.02, 1.0)),
    "noise_floor": Kind(chain.draw_noise, chain.noise, (2e-5, 3e-3)),
    "clock_drift": Kind(chain.draw_drift, chain.drift, (1e-5, 5e-3)),
    "harmonic_distortion": Kind(chain.draw_distortion, chain.distortion, (1e-4, 0.3)),
    "ringing_object": Kind(fields.draw_ringing, fields.ringing, (1e-3, 10.0)),
}
