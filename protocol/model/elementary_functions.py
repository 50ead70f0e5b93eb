"""Elementary functions of arrays, entry by entry, by the C library as `math` has them.

NumPy's own `exp`, `log`, `arctan2` and their like have one version for each vector unit, and these differ in the last
digit (docs/decisions/0011-one-digest-on-all-processors.md). What a digest depends on takes these instead. `np.sin`,
`np.cos`, `np.sqrt` and `np.hypot` are the same on all and may be used.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.kernel_array import FLOAT64, kernel_array

Floats = NDArray[np.float64]


def exp(values: Floats) -> Floats:
    """E to the power of each value; of any shape."""
    results: Floats = _exp(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def log(values: Floats) -> Floats:
    """Natural logarithm of each value, which must be above 0; of any shape."""
    results: Floats = _log(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def log10(values: Floats) -> Floats:
    """Decimal logarithm of each value, which must be above 0; of any shape."""
    results: Floats = _log10(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def arctan2(y: Floats, x: Floats) -> Floats:
    """Angle of each (x, y), from −π to π; both of one shape."""
    results: Floats = _arctan2(kernel_array(y, FLOAT64).reshape(-1), kernel_array(x, FLOAT64).reshape(-1))
    return results.reshape(y.shape)


@njit(cache=True, nogil=True)
def _exp(values: Floats) -> Floats:
    results = np.empty(values.shape[0])
    for i in range(values.shape[0]):
        results[i] = math.exp(values[i])
    return results


@njit(cache=True, nogil=True)
def _log(values: Floats) -> Floats:
    results = np.empty(values.shape[0])
    for i in range(values.shape[0]):
        results[i] = math.log(values[i])
    return results


@njit(cache=True, nogil=True)
def _log10(values: Floats) -> Floats:
    results = np.empty(values.shape[0])
    for i in range(values.shape[0]):
        results[i] = math.log10(values[i])
    return results


@njit(cache=True, nogil=True)
def _arctan2(y: Floats, x: Floats) -> Floats:
    results = np.empty(y.shape[0])
    for i in range(y.shape[0]):
        results[i] = math.atan2(y[i], x[i])
    return results
