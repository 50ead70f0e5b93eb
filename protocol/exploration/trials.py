"""Where robots were, and where they failed: evidence on what exploration leaves."""

from collections import deque

from robrain.protocol.model.geometry import Point2D

SAME_M = 0.6
"""Failures within this distance of each other are failures at one place."""
PITCH_M = 0.5
"""Places within one square of this size are kept as one."""
KEPT = 256
KEPT_BEEN = 16_384


class Trials:
    """Remembers a bounded number of places; the oldest are forgotten."""

    def __init__(self) -> None:
        self._failures: deque[tuple[Point2D, int]] = deque(maxlen=KEPT)
        self._been: dict[tuple[int, int], Point2D] = {}

    @property
    def failures(self) -> list[tuple[Point2D, int]]:
        """Places that robots failed to get to, arena frame, with the number of failures there."""
        return list(self._failures)

    @property
    def been(self) -> list[Point2D]:
        """Places where robots were, arena frame."""
        return list(self._been.values())

    def note_failure(self, place: Point2D) -> None:
        """Record that a robot failed to get to a place."""
        tries = 0
        for known in list(self._failures):
            if known[0].distance_m(place) < SAME_M:
                self._failures.remove(known)
                tries = max(tries, known[1])
        self._failures.append((place, tries + 1))

    def note_been(self, place: Point2D) -> None:
        """Record that a robot was at a place."""
        cell = round(place.x_m / PITCH_M), round(place.y_m / PITCH_M)
        self._been.pop(cell, None)
        self._been[cell] = place
        if len(self._been) > KEPT_BEEN:
            del self._been[next(iter(self._been))]
