"""Types of the arrays that functions take and return; shapes and units stand in their docstrings.

Type checkers know them. At run time they stand for any type, so that NumPy is imported by those that compute with it.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[Any]
    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int64]
    BoolArray = NDArray[np.bool_]
else:
    Array = FloatArray = IntArray = BoolArray = Any

Number = Any
"""A number in a compiled kernel, which is compiled for the precision that it is called with."""
Numbers = tuple[Any, ...]
