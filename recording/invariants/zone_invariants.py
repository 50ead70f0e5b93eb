"""Judges whether robots obey zones, by the ground truth."""

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.messages.team.zone_messages import Zones
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.zone import SPEED_SLACK, Zone, ZoneKind
from robrain.recording.invariants.invariant import Invariant, InvariantJudge, MissingEvidence, Surroundings

NEW_NS = to_ns(3.0)
"""A robot may still enter a keep-out zone, or drive too fast in one with a limit, that is as new as this."""
LEFT_NS = to_ns(60.0)
"""By then a robot has left a new keep-out zone."""
LOST_NS = to_ns(2.0)
"""A robot is judged again from this time after it has found its place or was resumed."""


class ZonesObeyed(InvariantJudge):
    """Finds robots that enter keep-out zones or occupied reserved ones, do not leave new ones, or drive too fast.

    Robots that are halted, lost or without the team's map frame are not judged.
    """

    invariant = Invariant.ZONES
    evidence = MissingEvidence.ZONES

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._zones: dict[str, Zone] = {}
        self._since_ns: dict[str, int] = {}
        """When each zone was first published as it is."""
        self._inside: dict[tuple[str, str], int] = {}
        """Robot and keep-out zone: since when it is inside."""
        self._reported: set[tuple[str, str]] = set()
        self._last: dict[str, tuple[RobotTruth, float]] = {}
        self._excused_ns: dict[str, int] = {}

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Follow which robots cannot obey."""
        if state.halted or state.lost or state.frame != ARENA or state.pose is None:
            self._excused_ns[state.robot] = time_ns

    def handle_zones(self, zones: Zones, time_ns: int) -> None:
        """Take the zones that hold from now on."""
        for zone in zones.zones:
            if self._zones.get(zone.name) != zone:
                self._since_ns[zone.name] = time_ns
        self._zones = {zone.name: zone for zone in zones.zones}
        self._inside = {key: since_ns for key, since_ns in self._inside.items() if key[1] in self._zones}
        self.cases = max(self.cases, len(self._zones))

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """Judge each robot in each zone."""
        for now in truth.robots if self._zones else ():
            last, last_s = self._last.get(now.robot, (now, truth.sim_time_s))
            self._last[now.robot] = now, truth.sim_time_s
            is_excused = time_ns - self._excused_ns.get(now.robot, time_ns - LOST_NS) < LOST_NS
            for zone in self._zones.values():
                if not zone.binds(now.robot):
                    continue
                if zone.keeps_out:
                    self._judge_place(now, last, zone, time_ns, is_excused=is_excused)
                elif zone.kind is ZoneKind.RESERVED:
                    self._judge_alone(now, last, zone, truth, time_ns)
                elif zone.speed_m_s is not None and not is_excused and truth.sim_time_s > last_s:
                    speed_m_s = (now.distance_m - last.distance_m) / (truth.sim_time_s - last_s)
                    self._judge_speed(now, last, zone, speed_m_s, time_ns)

    def _judge_place(self, now: RobotTruth, last: RobotTruth, zone: Zone, time_ns: int, *, is_excused: bool) -> None:
        key, since_ns = (now.robot, zone.name), self._since_ns[zone.name]
        if not zone.holds(_place(now)):
            self._inside.pop(key, None)
            self._reported.discard(key)
            return
        if is_excused:
            self._inside[key] = time_ns
            return
        entered_ns = self._inside.setdefault(key, time_ns)
        where = {"robot": now.robot, "zone": zone.name}
        if key in self._reported:
            return
        is_new = time_ns - since_ns <= NEW_NS
        if entered_ns == time_ns and not is_new and not self._is_leaving(last):
            self._reported.add(key)
            self.break_(time_ns, "entered", f"{now.robot} enters the keep-out zone {zone.name}", where)
        elif time_ns - entered_ns > LEFT_NS:
            self._reported.add(key)
            for_s = round(to_seconds(time_ns - entered_ns), 1)
            text = f"{now.robot} has not left the keep-out zone {zone.name} for {for_s:g} s"
            self.break_(time_ns, "not_left", text, {**where, "for_s": for_s})

    def _judge_alone(self, now: RobotTruth, last: RobotTruth, zone: Zone, truth: ArenaTruth, time_ns: int) -> None:
        is_new = time_ns - self._since_ns[zone.name] <= NEW_NS
        if is_new or not zone.holds(_place(now)) or zone.holds(_place(last)):
            return
        inside = [one.robot for one in truth.robots if zone.holds(_place(one)) and zone.binds(one.robot)]
        for other in inside:
            if other != now.robot:
                text = f"{now.robot} enters the reserved zone {zone.name}, where {other} is"
                self.break_(time_ns, "not_alone", text, {"robot": now.robot, "zone": zone.name, "other": other})

    def _is_leaving(self, last: RobotTruth) -> bool:
        """Whether the robot was in a keep-out zone, perhaps another one, from which the way out leads through this."""
        shut = (zone for zone in self._zones.values() if zone.keeps_out and zone.binds(last.robot))
        return any(zone.holds(_place(last)) for zone in shut)

    def _judge_speed(self, now: RobotTruth, last: RobotTruth, zone: Zone, speed_m_s: float, time_ns: int) -> None:
        limit_m_s = zone.speed_m_s or 0.0
        is_inside = zone.holds(_place(now)) and zone.holds(_place(last))
        if is_inside and speed_m_s > SPEED_SLACK * limit_m_s and time_ns - self._since_ns[zone.name] > NEW_NS:
            text = (
                f"{now.robot} drives at {speed_m_s:.2f} m/s in the zone {zone.name}, whose limit is {limit_m_s:g} m/s"
            )
            values = {"robot": now.robot, "zone": zone.name, "speed_m_s": round(speed_m_s, 3)}
            self.break_(time_ns, "too_fast", text, values)


def _place(truth: RobotTruth) -> Point2D:
    return Point2D(truth.pose.x_m, truth.pose.y_m)
