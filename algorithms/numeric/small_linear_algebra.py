"""Linear algebra of small matrices, with the same order of operations on every processor.

BLAS and LAPACK choose their routines by processor. The routines add in different orders, so the last digits of their
results differ, and with them the digest of a run (docs/decisions/0011-one-digest-on-all-processors.md). The functions
here are compiled without `fastmath`: sums run from left to right, and no multiply-add is contracted.

Vectors are (n,), matrices (n, m), float64, contiguous by rows; n is small. Shapes are not checked. Call these functions
only from Python: numba's cache of a kernel in another file that calls them would miss an edit here.
"""

import math

import numpy as np
from numba import njit

from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array


@njit(cache=True, nogil=True)
def dot(first: Floats, second: Floats) -> float:
    """Dot product of two vectors."""
    total = 0.0
    for i in range(first.shape[0]):
        total += first[i] * second[i]
    return total


@njit(cache=True, nogil=True)
def times_vector(matrix: Floats, vector: Floats) -> Floats:
    """Product (n,) of an (n, m) matrix and an (m,) vector."""
    product = np.empty(matrix.shape[0])
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        product[i] = total
    return product


@njit(cache=True, nogil=True)
def covariance_of(rows: Floats, covariance: Floats) -> Floats:
    """Covariance (n, n) of `rows` · v, for `rows` (n, m) and a vector v with covariance (m, m)."""
    count, size = rows.shape
    along = np.empty(size)
    result = np.empty((count, count))
    for i in range(count):
        for k in range(size):
            total = 0.0
            for j in range(size):
                total += rows[i, j] * covariance[j, k]
            along[k] = total
        for j in range(count):
            total = 0.0
            for k in range(size):
                total += along[k] * rows[j, k]
            result[i, j] = total
    return result


@njit(cache=True, nogil=True)
def quadratic_form(matrix: Floats, vector: Floats) -> float:
    """vectorᵀ · matrix · vector; if `matrix` is the covariance of v, the variance of `vector` · v."""
    total = 0.0
    for i in range(vector.shape[0]):
        along = 0.0
        for j in range(vector.shape[0]):
            along += matrix[i, j] * vector[j]
        total += vector[i] * along
    return total


@njit(cache=True, nogil=True)
def inverse_form(matrix: Floats, vector: Floats) -> float:
    """vectorᵀ · matrix⁻¹ · vector for a symmetric, positive definite matrix: a squared Mahalanobis distance.

    By Cholesky's factor L: the sum of squares of y with L · y = vector (Golub and Van Loan, *Matrix Computations*,
    section 4.2). Infinity if the matrix is not positive definite.
    """
    size = vector.shape[0]
    lower = np.empty((size, size))
    solution = np.empty(size)
    total = 0.0
    for i in range(size):
        for j in range(i):
            rest = matrix[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            lower[i, j] = rest / lower[j, j]
        pivot, right = matrix[i, i], vector[i]
        for k in range(i):
            pivot -= lower[i, k] * lower[i, k]
            right -= lower[i, k] * solution[k]
        if not pivot > 0.0:
            return math.inf
        lower[i, i] = math.sqrt(pivot)
        solution[i] = right / lower[i, i]
        total += solution[i] * solution[i]
    return total


@njit(cache=True, nogil=True)
def innovation_squared(rows: Floats, covariance: Floats, offsets: Floats, variances: Floats) -> float:
    """Squared Mahalanobis distance of `offsets` (n,), measured along `rows` (n, m) with these variances (n,).

    `covariance` (m, m) is that of the state of which the rows are linear functions.
    """
    expected = covariance_of(rows, covariance)
    for i in range(rows.shape[0]):
        expected[i, i] += variances[i]
    return inverse_form(expected, offsets)


@njit(cache=True, nogil=True)
def least_solution(rows: Floats, values: Floats) -> Floats:
    """The shortest v (m,) with `rows` · v = `values`, for `rows` (n, m) with n <= m.

    By modified Gram–Schmidt on the rows (Golub and Van Loan, section 5.2.8). A row that is linearly dependent on those
    before it is omitted.
    """
    count, size = rows.shape
    basis = rows.copy()
    rest = values.copy()
    solution = np.zeros(size)
    for i in range(count):
        square, before = 0.0, 0.0
        for k in range(size):
            square += basis[i, k] * basis[i, k]
            before += rows[i, k] * rows[i, k]
        if not square > 1e-24 * before:
            continue
        for k in range(size):
            solution[k] += rest[i] / square * basis[i, k]
        for j in range(i + 1, count):
            share = 0.0
            for k in range(size):
                share += basis[j, k] * basis[i, k]
            share /= square
            rest[j] -= share * rest[i]
            for k in range(size):
                basis[j, k] -= share * basis[i, k]
    return solution


def inverse(matrix: Floats) -> Floats:
    """Inverse of a symmetric, positive semi-definite (3, 3) matrix, by its adjugate.

    A small share of the trace is added to the diagonal, so that a singular matrix has an inverse too.
    """
    result: Floats = _inverse(kernel_array(matrix, FLOAT64))
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse(matrix: Floats) -> Floats:
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    lift = 1e-9 * (a + d + f) + 1e-12
    a, d, f = a + lift, d + lift, f + lift
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    result = np.empty((3, 3))
    result[0, 0] = (d * f - e * e) / determinant
    result[0, 1] = result[1, 0] = (c * e - b * f) / determinant
    result[0, 2] = result[2, 0] = (b * e - c * d) / determinant
    result[1, 1] = (a * f - c * c) / determinant
    result[1, 2] = result[2, 1] = (b * c - a * e) / determinant
    result[2, 2] = (a * d - b * b) / determinant
    return result


def symmetric(upper: tuple[float, ...]) -> Floats:
    """Symmetric (3, 3) matrix with this upper triangle (6,), row by row."""
    a, b, c, d, e, f = upper
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def is_semidefinite(matrix: Floats) -> bool:
    """Whether no principal minor of a symmetric (3, 3) matrix is negative, but for rounding."""
    (a, b, c), (_, d, e), (_, _, f) = matrix.tolist()
    largest = max(a, d, f)
    small = 1e-9 * largest
    minors = a * d - b * b, a * f - c * c, d * f - e * e
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return bool(min(a, d, f) >= 0.0 and min(minors) >= -small * largest and determinant >= -small * largest**2)
