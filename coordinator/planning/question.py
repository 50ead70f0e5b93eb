"""A problem in the form in which it is written down: small, and exact, so that it can be asked again.

Ways are whole centimetres; what they take a robot in joules and seconds follows from its profile. A problem with 20
places takes about 1 kB.
"""

import zlib

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.allocation.problem import Job, Problem, Worker

NO_WAY = 0xFFFF_FFFF
M_PER_CM = 0.01


class Profile(msgspec.Struct, frozen=True):
    """What ways take the robots of one kind."""

    start_j: float
    """To speed up, once a way."""
    j_per_m: float
    s_per_m: float


class Question(msgspec.Struct, frozen=True, kw_only=True):
    """What an allocator is asked."""

    jobs: tuple[Job, ...]
    workers: tuple[Worker, ...]
    profiles: tuple[Profile, ...]
    places: int
    ways_cm: bytes
    """Lengths between places: little-endian uint32, the upper triangle without the diagonal, row by row; `NO_WAY`
    where there is none. A way back is as long as the way there."""

    def problem(self) -> Problem:
        """The problem as the allocators take it."""
        length_m = np.zeros((self.places, self.places))
        rows, columns = np.triu_indices(self.places, 1)
        cm = np.frombuffer(self.ways_cm, "<u4")
        metres = np.where(cm == NO_WAY, np.inf, cm * M_PER_CM)
        length_m[rows, columns] = length_m[columns, rows] = metres
        moves = length_m > 0
        energy_j = np.stack([np.where(moves, one.start_j + one.j_per_m * length_m, 0.0) for one in self.profiles])
        time_s = np.stack([one.s_per_m * length_m for one in self.profiles])
        return Problem(jobs=self.jobs, workers=self.workers, energy_j=energy_j, time_s=time_s)

    def encode(self) -> bytes:
        """As `PlanProblem.question` has it."""
        return zlib.compress(_ENCODER.encode(self), 1)


def decode(encoded: bytes) -> Question:
    """What `Question.encode` made (ValueError if it did not)."""
    try:
        return msgspec.msgpack.decode(zlib.decompress(encoded), type=Question)
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(f"expected a question to the allocator: {error}") from error


def pack_ways(length_m: NDArray[np.float64]) -> bytes:
    """Lengths (n, n), metres, symmetric, as `Question.ways_cm` has them; infinite where there is no way."""
    upper = length_m[np.triu_indices(len(length_m), 1)]
    cm = np.where(np.isfinite(upper), np.ceil(np.where(np.isfinite(upper), upper, 0.0) / M_PER_CM), NO_WAY)
    return np.minimum(cm, NO_WAY).astype("<u4").tobytes()


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
