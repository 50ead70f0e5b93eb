"""A problem in the compact and exact form in which it is recorded, so that it can be solved again.

Path lengths are whole centimetres; joules and seconds follow from each robot's profile. A problem with 20 places takes
about 1 kB, one with 1,000 about 0.2 MB.
"""

import zlib
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.algorithms.allocation.problem import Job, Problem, Worker
from robrain.protocol.model.tasks.old_form import upgraded

M_PER_CM = 0.01
LONGEST_CM = 2**30
"""Limit of a path length: the difference of two fits into 32 bits."""

_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
NO_PATH = 0xFFFF_FFFF
_NONE = -1


class Profile(msgspec.Struct, frozen=True):
    """Path costs of the robots of one kind."""

    start_j: float
    """Joules to accelerate, once per path."""
    j_per_m: float
    s_per_m: float
    table: Annotated[int, Meta(ge=0, le=1000)] = 0
    """Index of the table of its path lengths."""


class ProblemRecord(msgspec.Struct, frozen=True, kw_only=True):
    """An allocator's input, as it is recorded."""

    jobs: tuple[Job, ...]
    workers: tuple[Worker, ...]
    profiles: tuple[Profile, ...]
    places: int
    paths_cm: bytes
    """Lengths between places: little-endian uint32, the upper triangle without the diagonal, row by row;
    `NO_PATH` where there is no path. Lengths are symmetric. One table follows the other."""

    path_deltas: bytes = b""
    """The recorded form, which replaces `paths_cm`: see `to_deltas`."""

    @property
    def tables(self) -> int:
        """Number of tables of path lengths."""
        return 1 + max((one.table for one in self.profiles), default=0)

    def problem(self) -> Problem:
        """The problem in the allocators' form."""
        table_m = np.zeros((self.tables, self.places, self.places))
        rows, columns = np.triu_indices(self.places, 1)
        cm = np.frombuffer(self.paths_cm, "<u4").reshape(self.tables, -1)
        table_m[:, rows, columns] = table_m[:, columns, rows] = np.where(cm == NO_PATH, np.inf, cm * M_PER_CM)
        length_m = table_m[[one.table for one in self.profiles]]
        start_j, j_per_m, s_per_m = (
            np.array([getattr(one, name) for one in self.profiles])[:, np.newaxis, np.newaxis]
            for name in ("start_j", "j_per_m", "s_per_m")
        )
        energy_j = np.where(length_m > 0, start_j + j_per_m * length_m, 0.0)
        time_s = s_per_m * length_m
        return Problem(jobs=self.jobs, workers=self.workers, energy_j=energy_j, time_s=time_s, length_m=length_m)

    def encode(self) -> bytes:
        """Encode it as `PlanProblem.question`."""
        tables = np.frombuffer(self.paths_cm, "<u4").reshape(self.tables, -1)
        deltas = b"".join(to_deltas(table, self.places) for table in tables)
        return zlib.compress(_ENCODER.encode(msgspec.structs.replace(self, paths_cm=b"", path_deltas=deltas)), 1)


def decode(encoded: bytes) -> ProblemRecord:
    """Decode the result of `ProblemRecord.encode` (ValueError if it is not one)."""
    try:
        question = msgspec.convert(upgraded(msgspec.msgpack.decode(zlib.decompress(encoded))), ProblemRecord)
        if not question.path_deltas:
            return question  # with few places, and in old recordings
        size = len(question.path_deltas) // question.tables
        parts = (question.path_deltas[index * size : (index + 1) * size] for index in range(question.tables))
        cm = np.concatenate([from_deltas(part, question.places) for part in parts])
    except (zlib.error, msgspec.DecodeError, ValueError, RecursionError) as error:
        raise ValueError(f"expected a question to the allocator: {error}") from error
    return msgspec.structs.replace(question, paths_cm=cm.astype("<u4").tobytes(), path_deltas=b"")


def encode_lengths(length_m: NDArray[np.float64]) -> bytes:
    """Encode lengths (n, n), metres, symmetric, infinite where there is no path, as `ProblemRecord.paths_cm`."""
    upper = length_m[np.triu_indices(len(length_m), 1)]
    cm = np.where(np.isfinite(upper), np.ceil(np.where(np.isfinite(upper), upper, 0.0) / M_PER_CM), NO_PATH)
    return np.where(cm == NO_PATH, NO_PATH, np.minimum(cm, LONGEST_CM)).astype("<u4").tobytes()


def to_deltas(cm: NDArray[np.uint32], places: int) -> bytes:
    """Pack lengths as differences.

    Args:
        cm: the upper triangle without the diagonal, row by row; `NO_PATH` where there is no path.
        places: number of places.

    Returns:
        The order, uint32 per place, and the differences, zigzag uint32, as four planes of bytes, lowest first.

    """
    table = np.zeros((places, places), np.int64)
    rows, columns = np.triu_indices(places, 1)
    table[rows, columns] = table[columns, rows] = np.where(cm == NO_PATH, _NONE, cm.astype(np.int64))
    order = _chain(table)
    table = table[np.ix_(order, order)]
    differences = np.diff(table, axis=0, prepend=0)[rows, columns]
    zigzag = np.where(differences < 0, -2 * differences - 1, 2 * differences).astype("<u4")
    return order.astype("<u4").tobytes() + zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()


def from_deltas(packed: bytes, places: int) -> NDArray[np.uint32]:
    """Unpack the result of `to_deltas` (ValueError if it is not one)."""
    count = places * (places - 1) // 2
    if len(packed) != 4 * (places + count):
        raise ValueError(f"expected {4 * (places + count)} bytes for the paths between {places} places")
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
    cm: NDArray[np.uint32] = np.where(back == _NONE, NO_PATH, back)[rows, columns].astype(np.uint32)
    return cm


def _chain(table: NDArray[np.int64]) -> NDArray[np.int64]:
    """Order the places so that each is followed by the nearest of the others."""
    places = len(table)
    order = np.zeros(places, np.int64)
    left = np.where(table == _NONE, np.iinfo(np.int64).max - 1, table)
    visited = np.zeros(places, np.bool_)
    for index in range(1, places):
        visited[order[index - 1]] = True
        order[index] = np.argmin(np.where(visited, np.iinfo(np.int64).max, left[order[index - 1]]))
    return order
