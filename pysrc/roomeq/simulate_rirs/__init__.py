"""Simulated RIR directories: one simulated response, and responses of noise sources, for each measured one."""

from roomeq.simulate_rirs.directory import simulate

__all__ = ["simulate"]
