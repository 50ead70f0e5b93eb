"""Many lengths in few bytes: places next to each other are about as far from everything else.

Places are put into an order in which each is near the one before; of each row of the table of lengths only what it
differs from the row before is written, byte planes apart, so that what deflates it finds its zeros together. Exact.
"""

import numpy as np
from numpy.typing import NDArray

NO_WAY = 0xFFFF_FFFF
_NONE = -1


def to_deltas(cm: NDArray[np.uint32], places: int) -> bytes:
    """Pack lengths.

    Args:
        cm: the upper triangle without the diagonal, row by row; `NO_WAY` where there is none.
        places: how many there are.

    Returns:
        The order, uint32 for each place, and the differences, zigzag uint32, as four planes of bytes, lowest first.

    """
    table = np.zeros((places, places), np.int64)
    rows, columns = np.triu_indices(places, 1)
    table[rows, columns] = table[columns, rows] = np.where(cm == NO_WAY, _NONE, cm.astype(np.int64))
    order = _chain(table)
    table = table[np.ix_(order, order)]
    differences = np.diff(table, axis=0, prepend=0)[rows, columns]
    zigzag = np.where(differences < 0, -2 * differences - 1, 2 * differences).astype("<u4")
    return order.astype("<u4").tobytes() + zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()


def from_deltas(packed: bytes, places: int) -> NDArray[np.uint32]:
    """What `to_deltas` packed (ValueError if it did not)."""
    count = places * (places - 1) // 2
    if len(packed) != 4 * (places + count):
        raise ValueError(f"expected {4 * (places + count)} bytes for the ways between {places} places")
    order = np.frombuffer(packed, "<u4", places).astype(np.int64)
    if sorted(order.tolist()) != list(range(places)):
        raise ValueError(f"expected an order of {places} places")
    planes = np.frombuffer(packed, np.uint8, 4 * count, 4 * places).reshape(4, count)
    zigzag = np.ascontiguousarray(planes.T).view("<u4").reshape(-1).astype(np.int64)
    rows, columns = np.triu_indices(places, 1)
    table = np.zeros((places, places), np.int64)
    table[rows, columns] = np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2)
    table = np.cumsum(table, axis=0)
    table = np.triu(table, 1)
    table += table.T
    back = np.empty((places, places), np.int64)
    back[np.ix_(order, order)] = table
    cm: NDArray[np.uint32] = np.where(back == _NONE, NO_WAY, back)[rows, columns].astype(np.uint32)
    return cm


def _chain(table: NDArray[np.int64]) -> NDArray[np.int64]:
    """The places, each followed by the nearest that is left."""
    places = len(table)
    order = np.zeros(places, np.int64)
    left = np.where(table == _NONE, np.iinfo(np.int64).max - 1, table)
    taken = np.zeros(places, np.bool_)
    for index in range(1, places):
        taken[order[index - 1]] = True
        order[index] = np.argmin(np.where(taken, np.iinfo(np.int64).max, left[order[index - 1]]))
    return order
