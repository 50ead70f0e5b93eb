"""Elementwise elementary functions of arrays, computed by the C library as in `math`.

NumPy's own `exp`, `log`, `arctan2` and the like have one version per vector unit, and these differ in the last digit
(docs/decisions/0011-one-digest-on-all-processors.md). Use these functions for anything that a digest depends on.
`np.sin`, `np.cos`, `np.sqrt` and `np.hypot` are the same on all processors.
"""

import math

import numpy as np
from numba import njit

from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array


def exp(values: Floats) -> Floats:
    """Exponential of each value; any shape."""
    results: Floats = _exp(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def log(values: Floats) -> Floats:
    """Natural logarithm of each value, which must be above 0; any shape."""
    results: Floats = _log(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def log10(values: Floats) -> Floats:
    """Decimal logarithm of each value, which must be above 0; any shape."""
    results: Floats = _log10(kernel_array(values, FLOAT64).reshape(-1))
    return results.reshape(values.shape)


def arctan2(y: Floats, x: Floats) -> Floats:
    """Angle of each (x, y), from −π to π; `y` and `x` have the same shape."""
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
