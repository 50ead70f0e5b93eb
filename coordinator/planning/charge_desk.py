"""Sends robots to charge, by tasks of the coordinator's own."""

import re

from robrain.coordinator.planning.charging import FULL_ENOUGH, Charge, Idle, assign_chargers, nearest
from robrain.coordinator.planning.members import HOMEWARD
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.roster import Robot, Roster
from robrain.coordinator.task_book import TaskBook
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Recharge, TaskState, place_of
from robrain.protocol.wire.clock import to_ns

AGAIN_NS = to_ns(30.0)
"""A robot that refused to charge, or failed at it, is not sent again for so long (chosen)."""
FOR_ENERGY = re.compile(r"reserve|lacks \d+ J|not the energy")
"""How the allocators say that a robot has too little energy for a task."""


class ChargeDesk:
    """Decides who is to charge.

    Args:
        planning: knows the chargers, and who has tasks.
        book: of the tasks.
        roster: the robots that there are.

    """

    def __init__(self, planning: Planning, book: TaskBook, roster: Roster) -> None:
        self.waiting: dict[str, str] = {}
        """Robots that should charge and do not, and why."""
        self._planning = planning
        self._book = book
        self._roster = roster
        self._not_before_ns: dict[str, int] = {}

    def choose(self, idle: list[Robot], now_ns: int) -> list[Charge]:
        """Robots, of those without a task, that are to set out for a charger now."""
        planning = self._planning
        if not any(planning.chargers.of.values()):
            return []
        self._not_before_ns = {name: at for name, at in self._not_before_ns.items() if at > now_ns}
        short = any(FOR_ENERGY.search(left.why) for left in planning.left_out.values())
        below = FULL_ENOUGH if short else planning.policy.charge_below
        found = [one for robot in idle if (one := self._idle(robot, now_ns)) is not None]
        if not any(one.soc < below for one in found):
            self.waiting = {}
            return []
        charges, self.waiting = assign_chargers(found, self._taken(), below)
        return charges

    def ended(self, robot: str, state: TaskState, now_ns: int) -> None:
        """A robot's charge has ended, or was refused."""
        if state is not TaskState.DONE:
            self._not_before_ns[robot] = now_ns + AGAIN_NS

    def _idle(self, robot: Robot, now_ns: int) -> Idle | None:
        state, name = robot.state, robot.name
        if state is None or state.pose is None or state.battery is None or state.battery.charging:
            return None
        if name in self._not_before_ns or self._planning.why_out(robot, now_ns) or self._planning.has_route(name):
            return None
        chargers = self._planning.chargers.of.get(name, ())
        return Idle(name, Point2D(state.pose.x_m, state.pose.y_m), state.battery.soc, chargers)

    def _taken(self) -> list[Point2D]:
        """Where somebody charges or goes to, by a task or of its own accord."""
        taken = [place_of(record.task) for record in self._book.open if isinstance(record.task, Recharge)]
        for robot in self._roster.robots.values():
            state = robot.state
            if state is None or state.pose is None or not robot.has_token:
                continue
            charging = state.battery is not None and state.battery.charging
            if charging or state.behavior in HOMEWARD:
                place = nearest(Point2D(state.pose.x_m, state.pose.y_m), self._planning.chargers.of.get(robot.name, ()))
                taken += [place] if place is not None else []
        return taken
