"""Deliver: picks up items and brings them to their places, several on a trip."""

import itertools

from robrain.algorithms.allocation.delivery_trip import trip_order
from robrain.plugins.behavior.errand import AWAY_M, Errand, Run, Script
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.skill.energy import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.tasks.stock_kinds import DELIVER, Deliver, Item
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import OfferRefusal, plain

TRIPS_KEPT = 16
"""Unfinished trips that a robot remembers."""


class DeliverBehavior(Errand[Deliver]):
    """Picks up items and brings them to their places.

    A robot that is interrupted has items on board. If it gets the task again, it continues with the next stop.
    """

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """Capacity of the robot."""

        capacity_kg: Positive = 10.0

    kind = DELIVER
    parameters: Parameters

    def refusal(self, run: Run[Deliver]) -> OfferRefusal | None:
        """An item may be too heavy."""
        heaviest_kg = max(item.payload_kg for item in _items(run.task, run.parameters))
        if heaviest_kg > self.parameters.capacity_kg:
            text = f"{self.env.robot} carries at most {self.parameters.capacity_kg:g} kg, not {heaviest_kg:g} kg"
            return plain("too_heavy", text)
        return super().refusal(run)

    def work(self, task: Task, deliver: Deliver) -> Work:
        """The paths from stop to stop, by the map, with their loads, and the time at the stops."""
        path_m = carried_kg_m = load_kg = 0.0
        stops = self._stops(task, deliver)
        for (place, change_kg), (following, _) in itertools.pairwise(stops):
            load_kg += change_kg
            leg_m = self.budget.path_m(place, following)
            path_m += leg_m
            carried_kg_m += max(0.0, load_kg) * leg_m
        return Work(path_m, wait_s=len(stops) * task.service_s, carried_kg_m=carried_kg_m, ends_at=stops[-1][0])

    def init(self) -> None:
        super().init()
        self._trips: dict[str, list[Point2D]] = {}
        """Remaining stops of the tasks that were begun."""

    def play(self, task: Task, deliver: Deliver) -> Script:
        """As usual; a trip that was begun continues with its next stop."""
        return (yield from (self.do if task.id in self._trips else super().play)(task, deliver))

    def do(self, task: Task, deliver: Deliver) -> Script:
        """Drive from stop to stop. Result: `delivered` items."""
        left = self._trips.setdefault(task.id, [place for place, _ in self._stops(task, deliver)])
        if len(self._trips) > TRIPS_KEPT:
            del self._trips[next(iter(self._trips))]
        while left:
            if self.away_m(left[0]) > AWAY_M:
                yield from self.go(left[0])
            yield from self.wait(task.service_s)
            del left[0]
            self.env.tasks.carry(task.id)
        del self._trips[task.id]
        return {"delivered": 1 + len(deliver.items)}

    def _stops(self, task: Task, deliver: Deliver) -> list[tuple[Point2D, float]]:
        """The places to stop at in turn, each with the change of the load in kg."""
        items = _items(task, deliver)
        places = [place for item in items for place in (item.pick_up, item.to)]
        changes_kg = [change_kg for item in items for change_kg in (item.payload_kg, -item.payload_kg)]
        order = [0, 1]
        if len(items) > 1:
            lengths_m = [self.budget.lengths_m(place, places) for place in places]
            order = trip_order([item.payload_kg for item in items], self.parameters.capacity_kg, lengths_m)
        return [(places[stop], changes_kg[stop]) for stop in order]


def _items(task: Task, deliver: Deliver) -> list[Item]:
    return [Item(pick_up=task.place, to=deliver.to, payload_kg=deliver.payload_kg), *deliver.items]
