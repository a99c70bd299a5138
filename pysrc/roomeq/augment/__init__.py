"""Far-field speech from clean speech: choose RIRs and noises, mix them, pack the result into a data directory."""

from roomeq.augment.far_field import augment

__all__ = ["augment"]
