"""Defaults of the simulation, which name its options where nothing is simulated."""

from pathlib import Path

NUM_RAYS = 10000
ISM_ORDER = 6
ORDER = 200
DEFAULT_TABLE = Path(__file__).with_name("materials.toml")
"""Table of materials; conf/materials.toml links to it."""
TARGET_RANGE_S = 0.05, 10.0
"""Reverberation times at 1 kHz that may be asked for [s]."""
