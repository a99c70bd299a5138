"""Pictures, sound and numbers of an RIR, of a set of RIRs or of a closed loop, and comparisons of two of them."""

from roomeq.show.step import compare, show

__all__ = ["compare", "show"]
