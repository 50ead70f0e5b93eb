"""Arrays for compiled kernels: each argument has one array type, whatever the input.

numba compiles a kernel once for each combination of types. An array that is read-only or not contiguous has a separate
type. A suitable array is returned unchanged. This check takes a tenth of the time of `numpy.require`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BOOL, INT8, INT32, INT64 = np.dtype(np.bool_), np.dtype(np.int8), np.dtype(np.int32), np.dtype(np.int64)
UINT8, FLOAT32, FLOAT64 = np.dtype(np.uint8), np.dtype(np.float32), np.dtype(np.float64)
Floats = NDArray[np.float64]


def kernel_array(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array itself if it has this type and is C-contiguous, aligned and writable; otherwise a copy that is."""
    if array.dtype == dtype and array.flags.carray:
        return array
    return np.require(array, dtype, ("C", "A", "W"))
