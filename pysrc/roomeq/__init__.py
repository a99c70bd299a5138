"""Simulated room impulse responses that learn from measured ones, and Kaldi data made with them.

The names below are the public interface. They are imported when they are first used, so ``import roomeq`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from roomeq.acoustics.parameters import measure as analyse
    from roomeq.augment.reverberate import Reverberate
    from roomeq.corpora.characterise import characterise
    from roomeq.eq.compensation import compensate_rir
    from roomeq.eq.steps import compensate, fit_eq
    from roomeq.loop.step import close_loop
    from roomeq.records.rir_dir import load_rir, read_rirs
    from roomeq.rooms import Loudspeaker, Room, simulate_rir
    from roomeq.show.sheet import plot_rir
    from roomeq.sim.directivity import DirectivityTable, FirstOrder
    from roomeq.sim.materials import named_scene
    from roomeq.sim.mesh import MeshRoom, load_mesh
    from roomeq.sim.response import simulate_responses
    from roomeq.sim.scene import Air, Material, Scene, Shoebox
    from roomeq.sim.sofa_directivity import read_directivity
    from roomeq.simulate_rirs import simulate

_HOME = {
    "Air": "sim.scene", "DirectivityTable": "sim.directivity", "FirstOrder": "sim.directivity", "Loudspeaker": "rooms",
    "Material": "sim.scene", "MeshRoom": "sim.mesh", "Reverberate": "augment.reverberate", "Room": "rooms",
    "Scene": "sim.scene", "Shoebox": "sim.scene", "analyse": "acoustics.parameters:measure",
    "characterise": "corpora.characterise", "close_loop": "loop.step", "compensate": "eq.steps",
    "compensate_rir": "eq.compensation", "fit_eq": "eq.steps", "load_mesh": "sim.mesh", "load_rir": "records.rir_dir",
    "named_scene": "sim.materials", "plot_rir": "show.sheet", "read_directivity": "sim.sofa_directivity",
    "read_rirs": "records.rir_dir", "simulate": "simulate_rirs", "simulate_responses": "sim.response",
    "simulate_rir": "rooms",
}
"""Module of each public name, and its name there if it is another."""

__all__ = [
    "Room", "simulate_rir", "FirstOrder", "Loudspeaker", "DirectivityTable", "read_directivity", "analyse",
    "Reverberate", "Air", "Material", "Shoebox", "MeshRoom", "load_mesh", "Scene", "named_scene", "simulate_responses",
    "read_rirs", "load_rir", "characterise", "simulate", "fit_eq", "compensate", "compensate_rir", "close_loop",
    "plot_rir",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomeq' has no attribute {name!r}: it has {', '.join(__all__)}")
    module, _, function = _HOME[name].partition(":")
    value = getattr(import_module(f"roomeq.{module}"), function or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
