"""Options of the simulation that rendering depends on."""

from dataclasses import dataclass

from roomeq.core.constants import LARGEST_SEED, is_whole

NOISE_CANDIDATES = 4
"""Largest number of noise sources of an RIR."""


@dataclass(frozen=True)
class RenderOptions:
    """Options of `roomeq.simulate_rirs.simulate` that rendering depends on."""

    t60_range_s: tuple[float, float] | None
    """Of the targets [s]; None: those of the room types."""
    num_rays: int
    ism_order: int
    order: int
    noise_rirs: int
    diffraction: bool
    fs_hz: int
    seed: int


def check_options(options: RenderOptions) -> None:
    """Raise a `ValueError` where an option is of the wrong type or out of range."""
    for name, low, high in (("num_rays", 100, 10 ** 7), ("ism_order", 0, 20), ("order", 1, 10 ** 4),
                            ("noise_rirs", 0, NOISE_CANDIDATES), ("seed", 0, LARGEST_SEED)):
        value = getattr(options, name)
        if not is_whole(value):
            raise ValueError(f"{name}={value!r} must be a whole number: correct it")
        if not low <= value <= high:
            raise ValueError(f"{name}={value} must lie in [{low}, {high}]: choose another number")
