"""Measured-like RIRs with an effect that nobody is told of, to judge the closed loop by.

Nothing here comes from roomeq's simulator, its effects or its loop: rooms, image sources, ray tracer, air, filters
and wave solver are another set of code, so that the loop cannot recognise itself. `make_room_set` is all there is to
call; `python -m testbed KIND --strength 2 --seed 1 --out DIR` does the same (with `tests` on the path).
With `--base pyroomacoustics` that simulator makes the rooms that the effect is added to.
"""

from testbed.bases import BASES
from testbed.generate import make_room_set
from testbed.kinds import KINDS

__all__ = ["BASES", "KINDS", "make_room_set"]
