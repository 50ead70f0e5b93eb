"""A door on a timetable."""

import math
from collections.abc import Iterable

import numpy as np

from robrain.sim.traffic.specs import DoorSpec
from robrain.sim.traffic.walker import Disc
from robrain.sim.traffic.wall_stamps import Box

CLEAR_M = 0.5
"""A door closes if nobody is nearer than this, so that nobody who is about to pass meets it."""


class Door:
    """Open or closed, by its timetable and by who stands in it.

    Args:
        name: in the arena's truth.
        spec: its place and timetable.
        rng: draws its phase.

    """

    def __init__(self, name: str, spec: DoorSpec, rng: np.random.Generator) -> None:
        self.name = name
        self._spec = spec
        drawn = float(rng.random())  # always, so that other doors keep theirs
        period_s = spec.period_s or 0.0
        self._phase_s = spec.phase_s if spec.phase_s is not None else drawn * period_s
        (from_x_m, from_y_m), (to_x_m, to_y_m) = spec.from_m, spec.to_m
        off_x_m, off_y_m = to_x_m - from_x_m, to_y_m - from_y_m
        length_m = math.sqrt(off_x_m * off_x_m + off_y_m * off_y_m)
        along = (off_x_m / length_m, off_y_m / length_m)
        self.box = Box((from_x_m + to_x_m) / 2, (from_y_m + to_y_m) / 2, along, length_m, spec.thickness_m)
        """What it closes."""
        self.is_open = True
        """Before the first step it is."""

    def is_due_open(self, now_s: float) -> bool:
        """Whether the timetable says open."""
        spec = self._spec
        if spec.period_s is None:
            return any(opens_s <= now_s < closes_s for opens_s, closes_s in spec.open_s or ())
        return (now_s - self._phase_s) % spec.period_s < spec.open_share * spec.period_s

    def step(self, now_s: float, discs: Iterable[Disc]) -> bool:
        """Open or close; whether it has changed.

        Args:
            now_s: simulated time.
            discs: everybody who may stand in it.

        """
        due = self.is_due_open(now_s)
        if due == self.is_open or (not due and not self._is_clear(discs)):
            return False
        self.is_open = due
        return True

    def _is_clear(self, discs: Iterable[Disc]) -> bool:
        return all(self.box.distance_m(x_m, y_m) > radius_m + CLEAR_M for x_m, y_m, radius_m in discs)
