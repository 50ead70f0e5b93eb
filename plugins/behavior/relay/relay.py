"""Relay: is the link to a mote. Holds its place while the mote is heard well enough, and moves nearer if not."""

import math

from robrain.plugins.behavior.errand import Errand, Script
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.skill.energy.interface import Work
from robrain.plugins.unit.snw_exploration.interface import HeardMote, SnwInterface
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Relay
from robrain.protocol.wire.clock import to_ns, to_seconds

NEW_SHARE = 0.3
"""How much a packet's strength counts against those before: fading must not move the robot."""


class RelayBehavior(Errand):
    """Holds a link."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """How the robot moves for the link's sake; chosen."""

        step_m: float = 0.7
        stray_m: float = 3.0
        """It stays this near to the task's place."""
        adjust_s: float = 6.0
        """After a move the new link is listened to for so long."""
        silent_s: float = 15.0
        """A mote that has not been heard for so long has no link."""

        def __post_init__(self) -> None:
            super().__post_init__()
            for name in ("step_m", "stray_m", "adjust_s", "silent_s"):
                if not getattr(self, name) > 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

    kind = Relay
    parameters: Parameters

    def activate(self) -> None:
        self._snw = self.env.use("snw_exploration", SnwInterface)
        super().activate()

    def work(self, task: Relay) -> Work:
        """Standing, and the way to as far as it may stray."""
        return Work(path_m=self.parameters.stray_m, wait_s=task.duration_s)

    def do(self, task: Relay) -> Script:
        """Hold the link. Result: `share_linked` of the time, mean `rssi_dbm`, `moved_m` from the place."""
        begun_ns = last_ns = self.env.clock.now_ns()
        until_ns, adjust_ns = begun_ns + to_ns(task.duration_s), begun_ns + to_ns(self.parameters.adjust_s)
        linked_ns, rssi_dbm, stamp_ns = 0, None, 0
        strengths: list[float] = []
        while last_ns < until_ns:
            yield
            now_ns = self.env.clock.now_ns()
            mote = self._heard(task.mote)
            if mote is not None and mote.stamp_ns > max(stamp_ns, begun_ns):
                stamp_ns = mote.stamp_ns
                old_dbm = mote.rssi_dbm if rssi_dbm is None else rssi_dbm
                rssi_dbm = old_dbm + NEW_SHARE * (mote.rssi_dbm - old_dbm)
                strengths.append(mote.rssi_dbm)
            is_silent = now_ns - max(stamp_ns, begun_ns) > to_ns(self.parameters.silent_s)
            is_linked = rssi_dbm is not None and not is_silent and rssi_dbm >= task.rssi_min_dbm
            linked_ns += (now_ns - last_ns) * is_linked
            last_ns = now_ns
            if not is_linked and now_ns >= adjust_ns:
                nearer = self._nearer(task, mote)
                if nearer is not None:
                    yield from self.go(nearer)
                    rssi_dbm = None
                adjust_ns = self.env.clock.now_ns() + to_ns(self.parameters.adjust_s)
        mean_dbm = sum(strengths) / len(strengths) if strengths else None
        return {
            "share_linked": round(linked_ns / (last_ns - begun_ns), 3),
            "rssi_dbm": None if mean_dbm is None else round(mean_dbm, 1),
            "packets": len(strengths),
            "moved_m": round(self.away_m(task.place), 2),
            "held_s": round(to_seconds(last_ns - begun_ns), 1),
        }

    def _nearer(self, task: Relay, mote: HeardMote | None) -> Point2D | None:
        """A step along the way to the mote, no farther from the task's place than allowed; None if there is none."""
        if mote is None or mote.place is None:
            return None
        path = self.travel.plan(mote.place)
        if not path:
            return None
        pose = self.travel.pose()
        at, left_m = Point2D(pose.x_m, pose.y_m), self.parameters.step_m
        for corner in path:
            leg_m = math.hypot(corner.x_m - at.x_m, corner.y_m - at.y_m)
            if leg_m >= left_m:
                share = left_m / leg_m
                at = Point2D(at.x_m + share * (corner.x_m - at.x_m), at.y_m + share * (corner.y_m - at.y_m))
                break
            at, left_m = corner, left_m - leg_m
        strays_m = math.hypot(at.x_m - task.place.x_m, at.y_m - task.place.y_m)
        return at if strays_m <= self.parameters.stray_m and pose.distance_m(at) > 0.1 else None

    def _heard(self, mote: str) -> HeardMote | None:
        return next((heard for heard in self._snw.heard() if heard.mote == mote), None)
