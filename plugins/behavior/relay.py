"""Relay: is the link to a mote, to another robot, or between the two, as one of a chain.

Holds its place while all its links are good enough. If one is not, it moves nearer to that end, by steps, while that
link is clearly the weakest. Between two weak links of like strength there is no better place.
"""

from typing import Any

from robrain.plugins.behavior.errand import Errand, Run, Script
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.skill.energy import Work
from robrain.plugins.unit.snw_exploration.interface import SnwInterface
from robrain.plugins.unit.teammates import TeammatesInterface
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.model.geometry import Point2D, point_along
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.tasks.stock_kinds import RELAY, Relay
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import OfferRefusal, PlainReason

BALANCE_DB = 3.0
"""A step towards the weaker of two links must be worth more than this; about the change by a step of the usual size."""

NEW_SHARE = 0.3
"""Weight of a packet's strength against earlier ones: fading must not move the robot."""
SILENT_DBM = -1000.0
"""Strength of a link on which nothing is received."""


class HeldLink:
    """The link to one mote or robot.

    Args:
        begun_ns: earlier packets do not count.
        silent_ns: an end that was not received for this time has no link.

    """

    def __init__(self, begun_ns: int, silent_ns: int) -> None:
        self.place: Point2D | None = None
        """Place of the other end, arena frame; None while it is unknown."""
        self.strengths_dbm: list[float] = []
        self._begun_ns = begun_ns
        self._silent_ns = silent_ns
        self._stamp_ns = 0
        self._rssi_dbm: float | None = None

    def record(self, rssi_dbm: float, stamp_ns: int) -> None:
        """Record the last packet, repeated or new."""
        if stamp_ns <= max(self._stamp_ns, self._begun_ns):
            return
        self._stamp_ns = stamp_ns
        old_dbm = rssi_dbm if self._rssi_dbm is None else self._rssi_dbm
        self._rssi_dbm = old_dbm + NEW_SHARE * (rssi_dbm - old_dbm)
        self.strengths_dbm.append(rssi_dbm)

    def strength_dbm(self, now_ns: int) -> float:
        """Strength of the link; SILENT_DBM if nothing was received for too long, or since the robot has moved."""
        if self._rssi_dbm is None or now_ns - max(self._stamp_ns, self._begun_ns) > self._silent_ns:
            return SILENT_DBM
        return self._rssi_dbm

    def move(self) -> None:
        """The robot has moved: earlier packets show nothing about its new place."""
        self._rssi_dbm = None

    @property
    def mean_dbm(self) -> float | None:
        """Mean of all received packets, to a tenth; None if there was none."""
        return round(sum(self.strengths_dbm) / len(self.strengths_dbm), 1) if self.strengths_dbm else None


class RelayBehavior(Errand[Relay]):
    """Keeps a radio link to a mote, a robot, or both."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """Motion of the robot for a better link; chosen."""

        step_m: Positive = 0.7
        stray_m: Positive = 3.0
        """Greatest distance from the task's place."""
        adjust_s: Positive = 6.0
        """Time for which the new link is measured after a move."""
        silent_s: Positive = 15.0
        """Time of silence after which a link counts as lost."""

    kind = RELAY
    parameters: Parameters

    def activate(self) -> None:
        self._snw = self.env.use("snw_exploration", SnwInterface)
        self._others = self.env.use("teammates", TeammatesInterface)
        super().activate()

    def work(self, task: Task, relay: Relay) -> Work:
        """Standing, and the path as far as it may stray."""
        return Work(path_m=self.parameters.stray_m, wait_s=relay.duration_s)

    def refusal(self, run: Run[Relay]) -> OfferRefusal | None:
        """A robot cannot be the link to itself."""
        if run.parameters.robot == self.env.robot:
            return PlainReason("a robot is no relay to itself")
        return super().refusal(run)

    def do(self, task: Task, relay: Relay) -> Script:
        """Hold the links. Result: `share_linked` of the time, mean `rssi_dbm`, `moved_m` from the place."""
        begun_ns = last_ns = self.env.clock.now_ns()
        until_ns, adjust_ns = begun_ns + to_ns(relay.duration_s), begun_ns + to_ns(self.parameters.adjust_s)
        linked_ns = 0
        silent_ns = to_ns(self.parameters.silent_s)
        ends = {"mote": relay.mote, "robot": relay.robot}
        links = {end: HeldLink(begun_ns, silent_ns) for end, name in ends.items() if name}
        while last_ns < until_ns:
            yield
            now_ns = self.env.clock.now_ns()
            self._listen(relay, links)
            strengths_dbm = sorted(link.strength_dbm(now_ns) for link in links.values())
            is_linked = strengths_dbm[0] >= relay.rssi_min_dbm
            linked_ns += (now_ns - last_ns) * is_linked
            last_ns = now_ns
            if not is_linked and now_ns >= adjust_ns:
                weakest = min(links.values(), key=lambda link: link.strength_dbm(now_ns))
                is_clear = len(links) == 1 or strengths_dbm[1] - strengths_dbm[0] > BALANCE_DB
                nearer = self._nearer(task.place, weakest.place) if is_clear else None
                if nearer is not None:
                    yield from self.go(nearer)
                    for link in links.values():
                        link.move()
                adjust_ns = self.env.clock.now_ns() + to_ns(self.parameters.adjust_s)
        share = round(linked_ns / (last_ns - begun_ns), 3)
        return self._result(task, relay, links, share, to_seconds(last_ns - begun_ns))

    def _listen(self, relay: Relay, links: dict[str, HeldLink]) -> None:
        for mote in self._snw.motes():
            if mote.mote == relay.mote:
                links["mote"].record(mote.rssi_dbm, mote.stamp_ns)
                links["mote"].place = mote.place
        for robot in self._snw.robots():
            if robot.robot == relay.robot:
                links["robot"].record(robot.rssi_dbm, robot.stamp_ns)
        for teammate in self._others.others():
            if teammate.name == relay.robot:
                links["robot"].place = Point2D(teammate.pose.x_m, teammate.pose.y_m)

    def _result(
        self, task: Task, relay: Relay, links: dict[str, HeldLink], share_linked: float, held_s: float
    ) -> dict[str, Any]:
        first = links["mote" if relay.mote else "robot"]
        result: dict[str, Any] = {
            "share_linked": share_linked,
            "rssi_dbm": first.mean_dbm,
            "packets": len(first.strengths_dbm),
            "moved_m": round(self.away_m(task.place), 2),
            "held_s": round(held_s, 1),
        }
        if relay.mote and relay.robot:
            result["robot_rssi_dbm"] = links["robot"].mean_dbm
            result["robot_packets"] = len(links["robot"].strengths_dbm)
        return result

    def _nearer(self, place: Point2D, end: Point2D | None) -> Point2D | None:
        """A step along the path to an end, no farther from the task's place than allowed; None if there is none."""
        if end is None:
            return None
        path = self.travel.plan(end)
        if not path:
            return None
        at = point_along(self.travel.place(), path, self.parameters.step_m) or path[-1]
        return at if at.distance_m(place) <= self.parameters.stray_m and self.away_m(at) > 0.1 else None
