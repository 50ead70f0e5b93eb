"""Arrays as compiled kernels take them: one type for each argument, whatever was passed.

numba compiles a kernel once for each combination of types; an array that is read-only or not contiguous is of a type
of its own. What is as wanted is handed on as it is, in a tenth of the time that `numpy.require` takes to find that out.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BOOL, INT8, INT32, INT64 = np.dtype(np.bool_), np.dtype(np.int8), np.dtype(np.int32), np.dtype(np.int64)
FLOAT32, FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)
Floats = NDArray[np.float64]


def kernel_array(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array itself if it is of this type, contiguous by rows, aligned and writable; else a copy that is."""
    if array.dtype is dtype and array.flags.carray:
        return array
    return np.require(array, dtype, ("C", "A", "W"))
