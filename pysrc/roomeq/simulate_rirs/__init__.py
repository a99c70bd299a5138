"""Simulated RIR directories: one simulated RIR, and RIRs of noise sources, for each measured RIR."""

from roomeq.simulate_rirs.step import simulate

__all__ = ["simulate"]
