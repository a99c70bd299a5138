"""Types of the arrays that functions take and return; shapes and units stand in their docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Number = Any
"""A number in a compiled kernel, which is compiled for the precision that it is called with."""
Numbers = tuple[Any, ...]
