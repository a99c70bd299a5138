"""Far-field speech from clean speech: choose RIRs and noises, mix them, pack the result into a data directory."""

from roomeq.augment.step import augment

__all__ = ["augment"]
