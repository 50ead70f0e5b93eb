"""A problem in the form in which it is written down: small, and exact, so that it can be asked again.

Ways are whole centimetres; what they take a robot in joules and seconds follows from its profile. A problem with 20
places takes about 1 kB, one with 1,000 about 0.2 MB.
"""

import zlib

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.allocation.problem import Job, Problem, Worker
from robrain.coordinator.planning.length_codec import NO_WAY, from_deltas, to_deltas

M_PER_CM = 0.01
LONGEST_CM = 2**30
"""No way is longer: what two differ by is a whole number of 32 bits."""


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

    ways_deltas: bytes = b""
    """As they are written down, in place of `ways_cm`: see `way_deltas.py`."""

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
        deltas = to_deltas(np.frombuffer(self.ways_cm, "<u4"), self.places)
        return zlib.compress(_ENCODER.encode(msgspec.structs.replace(self, ways_cm=b"", ways_deltas=deltas)), 1)


def decode(encoded: bytes) -> Question:
    """What `Question.encode` made (ValueError if it did not)."""
    try:
        question = msgspec.msgpack.decode(zlib.decompress(encoded), type=Question)
        if not question.ways_deltas:
            return question  # with few places there are none; and this is how it was written once
        cm = from_deltas(question.ways_deltas, question.places)
    except (zlib.error, msgspec.DecodeError, ValueError) as error:
        raise ValueError(f"expected a question to the allocator: {error}") from error
    return msgspec.structs.replace(question, ways_cm=cm.astype("<u4").tobytes(), ways_deltas=b"")


def pack_ways(length_m: NDArray[np.float64]) -> bytes:
    """Lengths (n, n), metres, symmetric, as `Question.ways_cm` has them; infinite where there is no way."""
    upper = length_m[np.triu_indices(len(length_m), 1)]
    cm = np.where(np.isfinite(upper), np.ceil(np.where(np.isfinite(upper), upper, 0.0) / M_PER_CM), NO_WAY)
    return np.where(cm == NO_WAY, NO_WAY, np.minimum(cm, LONGEST_CM)).astype("<u4").tobytes()


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
