"""Travel: how a behavior gets to a place. It plans, follows, replans, gives way, and publishes its path to the team."""

from enum import Enum, auto

import numpy as np

from robrain.agent.environment import Environment
from robrain.algorithms.navigation.clearance import least_gap_m, mapped_clearance_m
from robrain.algorithms.navigation.reservations import ReservedArea
from robrain.algorithms.navigation.right_of_way import LONGEST_M, LOOK_AHEAD_M, STEP_M, Release, sample_path
from robrain.algorithms.navigation.separation import Separation
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.behavior.area_gate import AreaGate
from robrain.plugins.behavior.deconfliction import ROOM_S, Encounter, Leg, Outlet, TravelClaim, circles, swaths
from robrain.plugins.behavior.lost_search import PATIENCE_S, TASK_PATIENCE_S, LostSearch
from robrain.plugins.skill.localisation import LocalisationInterface
from robrain.plugins.skill.mapper.mapper import MapCells, MapperInterface
from robrain.plugins.skill.planner import PlannerInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates import Doing, NearbyRobot, TeammatesInterface
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, PlannedPath
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.claim import IDLE_S, Claim
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import OCCUPIED, UNKNOWN
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import Positive
from robrain.protocol.reasons import DoorShut, PositionLost, Shut, sentence_of, shut

FIND_ITSELF = "find itself"
"""Board text for a robot that searches for its place and has nothing else to do."""
REQUIRES = ("driver", "teammates", "localisation", "mapper", "planner")
"""Requirements of a behavior that travels, in its manifest."""
NEXT_CHECK_M = 0.4
"""Distance beyond the robot at which the check of the path for map changes begins. The path's start may be nearer to a
wall than it should be, and leads away from there."""
CREEP_S = 2.0
CREEP_POSITIONS = 3
"""Number of positions sent at a time for `CREEP_S` after the driver was blocked. The driver then takes no short cut,
which blocks robots at the corner of a narrow place."""
DETOUR_GAIN_M = 1.0
"""Least additional distance before the wait that makes another path with a wait better."""
RIGHT_S = 20.0
"""A robot keeps to the right for this time after another has come towards it (chosen: decision 0076)."""
MOVED_M = 0.1
"""Less than this is no motion."""
ROLL_M = 0.6
"""A robot that is ordered to stop rolls on by less than this."""
IDLE = Claim()
"""An idle robot yields to every robot with a task."""

LEAVES = Claim(order_s=0.5 * IDLE_S)
"""A robot that leaves a zone goes before idle ones, which make room."""
HELD_S = 2.0
"""Time that a robot that leaves a zone waits for others before it plans again (chosen)."""
NEAR_M = 0.8
"""A place counts as reachable if the robot can come as near to it (as `snap_m` of the planner)."""
GAP = "gap_m"
"""In the result of a task: the width of the gap that the robot does not fit through."""


class TravelParameters(Checked, frozen=True, forbid_unknown_fields=True):
    """When a place counts as reached, and how long the robot waits before obstacles; a base for a behavior's own."""

    arrived_m: Positive = 0.3
    """Distance at which a place counts as reached."""
    replan_s: Positive = 2.0
    """Interval of planning the path again."""
    replan_blocked_s: Positive = 0.5
    """Interval of searching for another path while an obstacle or another robot blocks this one."""
    patience_s: Positive = 3.0
    """Time before an obstacle after which the robot gives up."""
    teammate_margin_m: Positive = 0.15
    """Distance kept from standing robots, beyond both radii."""
    teammate_near_m: Positive = 8.0
    """Robots that are, or are going, within this distance are considered."""
    speed_m_s: Positive = 0.6
    """Speed of the driver, to predict meetings."""
    detour_m: Positive = 3.0
    """Longest detour that is preferred to waiting for another robot."""


class TravelState(Enum):
    """State of a travel."""

    MOVING = auto()
    WAITING = auto()
    """Under way, but waiting or aside until others have passed."""
    ARRIVED = auto()
    BLOCKED = auto()
    """Something has blocked the path for too long."""
    SHUT = auto()
    """A door has not opened, or a zone on the only path is cleared; `shut` is the reason."""
    TOO_NARROW = auto()
    """The path leads through a gap that is too narrow for the robot; `gap_m` is the gap's width."""
    NO_PATH = auto()
    """The planner no longer finds a path."""
    LOST = auto()
    """The robot is lost, and has not found its place."""


TROUBLE = {
    TravelState.BLOCKED: "the way is blocked",
    TravelState.SHUT: "a door or a zone on the way is closed",
    TravelState.TOO_NARROW: "the way is too narrow",
    TravelState.NO_PATH: "no way there",
    TravelState.LOST: "the robot does not know where it is",
}
"""Why a travel has failed."""


class Travel:
    """The travels of one behavior; made in its `init`, connected in its `activate`, stepped by its `step`.

    Args:
        env: the behavior's environment.
        parameters: the behavior's parameters.

    """

    def __init__(self, env: Environment, parameters: TravelParameters) -> None:
        self._env = env
        self._parameters = parameters
        self._goal: Point2D | None = None
        self._is_narrow_goal = False
        self._end: Point2D | None = None
        """As near to the goal as the planner leads."""
        self._leg: Leg | None = None
        self._travel_claim = TravelClaim()
        self._moved_at: Pose2D | None = None
        self._moved_ns = 0
        """When and where it was last seen to move."""
        self._since_ns = 0
        """Time at which it set out; another goal under way does not change it."""
        self._planned_ns = 0
        self._checked_ns = 0
        """Time of the last search for another path or a refuge."""
        self._contested_ns: int | None = None
        """When others last held the robot up."""
        self._right_until_ns = 0
        """Until when it keeps to the right, because a robot came towards it."""
        self._creep_until_ns = 0
        self._lost_ns: int | None = None
        """Time since which the planner has found no path."""
        self._version = -1
        """Version of the map on which the path was last found safe."""
        self._search: LostSearch | None = None
        self._aside_claim = IDLE
        """Claim of the leg of an idle robot."""
        self.roams = False
        """Whether the goals lie in the robot's own map frame, so that it may drive there while it is lost."""
        self.shut: Shut | None = None
        """The zone that last ended a travel with `SHUT`."""
        self.gap_m: float | None = None
        """Width of the gap that last stopped the robot; None for another cause."""
        self._has_reported_wait = False
        self.wait_s = 0.0
        """Estimated time until the robot for which it waits has passed; 0 if it waits for none."""

    def connect(self) -> None:
        """Connect the interfaces that it needs.

        Raises:
            PluginMissing, AccessDenied, PluginBusy: one of them is not available.

        """
        env = self._env
        self.driver = env.use("driver", DriverInterface)
        self.teammates = env.use("teammates", TeammatesInterface)
        self._localisation = env.use("localisation", LocalisationInterface)
        self._mapper = env.use("mapper", MapperInterface)
        self._planner = env.use("planner", PlannerInterface)
        self._paths = env.wire.publisher(ROBOT_PATH, robot=env.robot)
        speed_m_s = self._parameters.speed_m_s
        self._gate = AreaGate(env, self.teammates, self._mapper.view, self.driver.radius_m())
        self._outlet = Outlet(
            env.robot, speed_m_s, self.driver, self._localisation, self._paths.put, self._mapper.view, env.board
        )

    @property
    def teammate_near_m(self) -> float:
        """Robots that are, or are going, within this distance are considered."""
        return self._parameters.teammate_near_m

    @property
    def lost(self) -> str:
        """Reason why the robot must not drive to places of the arena, in words; empty if it may."""
        return sentence_of(self.position_lost) if self._env.board.lost else ""

    @property
    def position_lost(self) -> PositionLost | None:
        """The same as a reason: the robot is lost.

        None if it is not.
        """
        reason = self._env.board.lost
        return PositionLost(self._env.robot, reason) if reason else None

    def shut_before(self, goal: Point2D) -> Shut | None:
        """The shut zone without which the robot could reach a place; None if there is none."""
        view = self.view()
        if view.zones is None or view.seen is None or not any(zone.is_shut for zone in view.zones.zones):
            return None
        here, radius_m = self.place(), mapped_clearance_m(self.driver.radius_m(), view.geometry.resolution_m)
        out = self._planner.leave_zone(view, here)
        classes = np.where(view.seen == UNKNOWN, np.int8(OCCUPIED), view.seen)
        separation = Separation(classes, view.geometry, view.zones.zones, [out[-1] if out else here], radius_m)
        zone = separation.shut_before(goal, NEAR_M)
        return None if zone is None else shut(zone)

    def doors_s(self, path: list[Point2D]) -> float:
        """Time that the doors on a path from here take to open."""
        place = self.place()
        points = np.array([(point.x_m, point.y_m) for point in (place, *path)])
        return self._gate.opening_s(sample_path(points, LONGEST_M)) if self.view().areas else 0.0

    @property
    def doors_left_s(self) -> float:
        """The same for the path that it drives."""
        return 0.0 if self._leg is None or self._goal is None else self.doors_s(self._leg.left())

    def find_itself(self, *, for_task: bool = False) -> bool:
        """Drive about slowly while the robot is lost, bound for nowhere; False once that has failed.

        The goal is kept: when the robot is localised again, `step` continues to it.

        Args:
            for_task: whether a task is paused during the search.

        """
        now_ns = self._env.clock.now_ns()
        if self._search is None:
            goal = self._goal
            self.stop()
            self._goal = goal
            self._search = LostSearch(self.driver, now_ns)
        may_explore = for_task and self._env.board.frame != ARENA
        self._search.step(now_ns, TASK_PATIENCE_S if may_explore else PATIENCE_S)
        return not self._search.has_given_up

    def view(self) -> MapCells:
        """The map as it is now."""
        return self._mapper.view()

    def pose(self) -> Pose2D:
        """T_arena_robot now."""
        return self._localisation.pose()

    def place(self) -> Point2D:
        """The robot's place now, arena frame."""
        pose = self._localisation.pose()
        return Point2D(pose.x_m, pose.y_m)

    def plan(self, goal: Point2D) -> list[Point2D] | None:
        """A path from here to a place, arena frame, through narrow places if necessary; None if there is none."""
        encounter = self._meet(self.pose())
        for is_narrow in self._widths():
            path = self._plan(encounter, goal, is_narrow=is_narrow)
            if path is not None:
                return path
        return None

    def delay_s(self, pace_m_s: float, path: list[Point2D] | None = None) -> float:
        """Time that speed limits add to a path from here, by default the one that the robot drives."""
        zones, place, leg = self.view().zones, self.place(), self._leg
        if zones is None or (path is None and leg is None):
            return 0.0
        if path is not None:
            ahead = sample_path(np.array([(point.x_m, point.y_m) for point in (place, *path)]), LONGEST_M)
        elif leg is not None:
            ahead = leg.path.ahead(place.x_m, place.y_m, LONGEST_M)
        return zones.delay_s(ahead, STEP_M, pace_m_s)

    def may_stay(self, place: Point2D) -> bool:
        """Whether no zone forbids the robot to stay at a place."""
        zones = self.view().zones
        return zones is None or not zones.forbids_rest(place)

    def standpoint(self, place: Point2D, within_m: float) -> Point2D | None:
        """The nearest place from which the robot can see a place; None if walls hide it from there."""
        return self._planner.standpoint(self.view(), place, within_m)

    def narrow_standpoint(self, place: Point2D, within_m: float) -> Point2D | None:
        """As `standpoint`, but in a narrow place; None also if no path leads there."""
        found = self._planner.standpoint(self.view(), place, within_m, is_narrow=True)
        if found is None:
            return None
        path = self._plan(self._meet(self.pose()), found, is_narrow=True)
        near_m = 2.0 * self.view().geometry.resolution_m
        if path is None or path[-1].distance_m(found) > near_m:
            return None
        return found

    def set_out(self, *goals: Point2D, priority: float = 0.0, is_narrow: bool = False) -> bool:
        """Go to the first of these places that can be reached.

        Paths through narrow places are tried last, unless the goal or the robot is in one. Returns False and changes
        nothing if there is no path to any of the places or the robot is lost.

        Args:
            goals: the places, arena frame.
            priority: the task's; each degree counts like `PRIORITY_S` under way where paths meet.
            is_narrow: whether the first place is in a narrow place.

        """
        if self.lost and not self.roams:
            return False
        pose = self.pose()
        encounter = self._meet(pose)
        for squeezes in self._widths(to_narrow=is_narrow):
            for goal in goals:
                path = self._plan(encounter, goal, is_narrow=squeezes)
                if path is not None:
                    if self._goal is None:
                        self._since_ns = self._env.clock.now_ns()
                    self._goal = goal
                    self._is_narrow_goal = is_narrow and goal == goals[0]
                    self._contested_ns = None
                    self._gate.waited_at = ""
                    self._travel_claim.set_out(priority, self._since_ns)
                    self._go(self._handle(path, pose, is_narrow=squeezes), self._meet(pose), pose)
                    return True
        return False

    def step(self) -> TravelState:
        """Advance by one step, with a new path for the driver if one is due. Without a goal the travel has arrived."""
        if self._goal is None:
            return TravelState.ARRIVED
        if self.lost and not self.roams:
            return TravelState.WAITING if self.find_itself(for_task=True) else TravelState.LOST
        self._search = None
        pose, now_ns = self.pose(), self._env.clock.now_ns()
        if self._end is not None and pose.distance_m(self._end) < self._parameters.arrived_m:
            if self._leg is not None and self._leg.path.left_m > 2.0 * self._parameters.arrived_m:
                self.driver.stop()  # the path leads round something; nobody watches a robot that rolls on
            return TravelState.ARRIVED
        if self._env.tasks.is_paused:
            if self._leg is not None:
                self._leg.stop(self._travel_claim.claim)
            return TravelState.WAITING
        if self.driver.blocked_s() > self._parameters.patience_s:
            self.gap_m = self.driver.gap_m()
            return TravelState.BLOCKED if self.gap_m is None else TravelState.TOO_NARROW
        if self._gate.has_waited_too_long:
            self.shut = DoorShut(self._gate.shut_door)
            return TravelState.SHUT
        encounter = self._meet(pose)
        if self._must_replan(pose, now_ns) and not self._replan(encounter, self._goal, pose, now_ns):
            door = self._gate.shut_door
            self.shut = DoorShut(door) if door else self.shut_before(self._goal)
            return TravelState.NO_PATH if self.shut is None else TravelState.SHUT
        leg = self._leg
        return TravelState.WAITING if leg is None else self._go(leg, encounter, pose)

    def make_room(self) -> bool:
        """While idle, step aside for a robot that is to pass here; returns whether this robot is doing so."""
        if self._goal is not None or self._search is not None:
            return False
        leg = self._leg
        if self.lost:
            if leg is not None:
                self.stop()
            return False
        pose, now_ns = self.pose(), self._env.clock.now_ns()
        encounter = self._meet(pose, IDLE)
        if leg is not None:
            allowed = leg.guard(encounter, pose)
            is_held = allowed.positions < 2 and now_ns - self._checked_ns > to_ns(HELD_S)
            if not is_held and leg.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M).shape[0] > 2:
                self._drive(leg, allowed, pose, self._aside_claim)
                return True
            self.stop()
        self._gate.limit(_here(pose))
        is_due = now_ns - self._checked_ns > to_ns(self._parameters.replan_blocked_s)
        wanted = self._gate.wanted(_here(pose)) if is_due else None
        out = self._zone_exit(encounter, pose, wanted) if is_due else []
        if out:
            self._checked_ns, self._aside_claim = now_ns, LEAVES
            leg = self._leg = Leg(self._outlet, pose, out, is_escape=True)
            self._drive(leg, leg.guard(encounter, pose), pose, LEAVES)
            return True
        pressed_by = encounter.pressing(_here(pose), ROOM_S) if is_due else []
        if pressed_by:
            self._checked_ns = now_ns
            (presser, *_) = (teammate for teammate in encounter.teammates if teammate.name in pressed_by)
            leg = self._leg = self._refuge(encounter, pose, presser, self._widths())
            if leg is not None:
                self._aside_claim = IDLE
                self._drive(leg, leg.guard(encounter, pose), pose, IDLE)
                return True
        return False

    def _zone_exit(self, encounter: Encounter, pose: Pose2D, area: ReservedArea | None) -> list[Point2D]:
        """A path out of zones, and out of an area that others wait for.

        It leads past other robots if it can, otherwise to where idle ones have to make room.
        """
        margin_m = encounter.radius_m + self._parameters.teammate_margin_m
        others = [circle for doing in Doing for circle in circles(encounter.teammates, margin_m, doing)]
        leave, view, here = self._planner.leave_zone, self.view(), self.place()
        return leave(view, here, area, others, to_rest=True) or leave(view, here, area, to_rest=True)

    def coast(self) -> None:
        """Drop the goal, but let the robot roll on for about a second, because the next goal may come before."""
        leg = self._leg
        self.forget()
        if leg is None:
            return
        rest = leg.cut(self.pose(), self._parameters.speed_m_s)
        if rest is None:
            self.stop()
            return
        self._leg = rest
        rest.drive(Release(2, is_whole=True, must_leave=False, by=-1), IDLE)

    def forget(self) -> None:
        """Drop the goal; the driver keeps to its last path."""
        self._goal = None
        self._end = None
        self._leg = None
        self._search = None
        self._wait_for("")

    def stop(self) -> None:
        """Stop, and publish this. Areas are released, but those that the robot may still roll into."""
        if self._gate.is_in_use and not self.lost:  # a lost robot may be in any of them
            pose, leg = self.pose(), self._leg
            self._gate.limit(_here(pose) if leg is None else leg.path.ahead(pose.x_m, pose.y_m, ROLL_M))
        self.forget()
        self.driver.stop()
        self._paths.put(PlannedPath(robot=self._env.robot, points=[]))

    def _meet(self, pose: Pose2D, claim: Claim | None = None) -> Encounter:
        now_ns = self._env.clock.now_ns()
        if self._moved_at is None or pose.distance_m(self._moved_at) > MOVED_M:
            self._moved_at, self._moved_ns = pose, now_ns
        teammates = self.teammates.nearby(Point2D(pose.x_m, pose.y_m), self.teammate_near_m)
        radius_m = self.driver.radius_m() if teammates else 0.0
        leg = self._leg if claim is None and teammates else None
        ahead = None if leg is None else leg.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M)
        own, speed_m_s = claim or self._travel_claim.claim, self._parameters.speed_m_s
        return Encounter(self._env.robot, own, radius_m, teammates, speed_m_s, ahead, self._moved_ns, now_ns)

    def _replan(self, encounter: Encounter, goal: Point2D, pose: Pose2D, now_ns: int) -> bool:
        """Take a new path if there is one; False once none, narrow ones included, was found for `patience_s`."""
        was_narrow = self._leg is not None and self._leg.is_narrow
        first, other = self._widths(to_narrow=self._is_narrow_goal)
        path, is_narrow = self._plan(encounter, goal, is_narrow=first), first
        if path is None:
            is_hopeless = self._is_hopeless(now_ns)
            if was_narrow or is_hopeless:
                path, is_narrow = self._plan(encounter, goal, is_narrow=other), other
            if path is None:
                return not is_hopeless
        self._handle(path, pose, is_narrow=is_narrow)
        return True

    def _widths(self, *, to_narrow: bool = False) -> tuple[bool, bool]:
        """The order in which to try `is_narrow`: narrow paths last, unless goal or robot is in a narrow place."""
        if to_narrow:
            return True, False
        may_be_inside = self.driver.squeezes() or self.driver.blocked_s() > 0
        is_inside = may_be_inside and self._planner.is_narrow(self.view(), self.place())
        return is_inside, not is_inside

    def _plan(self, encounter: Encounter, goal: Point2D, *, is_narrow: bool = False) -> list[Point2D] | None:
        start, view, teammates = self.place(), self.view(), encounter.teammates
        margin_m = encounter.radius_m + self._parameters.teammate_margin_m
        dear = swaths(teammates, encounter, margin_m) if self._is_contested() else []
        keeps_right = self._env.clock.now_ns() < self._right_until_ns
        at_rest = circles(teammates, margin_m, Doing.IDLE)
        lasting = circles(teammates, margin_m, Doing.OBSTACLE)
        path = self._planner.plan(
            view, start, goal, lasting + at_rest, dear, is_narrow=is_narrow, keeps_right=keeps_right
        )
        if path is None and at_rest:  # a robot without a path may make room
            path = self._planner.plan(view, start, goal, lasting, dear, is_narrow=is_narrow, keeps_right=keeps_right)
        return path

    def _must_replan(self, pose: Pose2D, now_ns: int) -> bool:
        since_ns = now_ns - self._planned_ns
        leg = self._leg
        if leg is None:
            return True
        if leg.is_escape or self._lost_ns is not None:
            return since_ns > to_ns(self._parameters.replan_blocked_s)
        if since_ns > to_ns(self._parameters.replan_s):
            return True
        if since_ns <= to_ns(self._parameters.replan_blocked_s):
            return False
        if self.driver.blocked_s() > 0:
            # It has stopped before something that was not on the map when the path was planned, or too near to a wall.
            self._creep_until_ns = now_ns + to_ns(CREEP_S)
            return True
        return not self._is_safe(leg, pose)

    def _is_safe(self, leg: Leg, pose: Pose2D) -> bool:
        """Whether the map, if it has changed, still has room for the path ahead."""
        if self.view().version == self._version:
            return True
        self._version = self.view().version
        ahead = leg.path.ahead(pose.x_m, pose.y_m, LONGEST_M)
        return self._safe_positions(leg, ahead) == len(ahead)

    def _safe_positions(self, leg: Leg, ahead: Floats) -> int:
        skipped = round(NEXT_CHECK_M / STEP_M)
        safe = self._planner.safe_positions(self.view(), ahead[skipped:], is_narrow=leg.is_narrow)
        return min(len(ahead), skipped + safe)

    def _is_hopeless(self, now_ns: int) -> bool:
        """No path was found, and not for the first time: one or two wrong readings may close narrow places."""
        self._planned_ns = now_ns
        if self._lost_ns is None:
            self._lost_ns = now_ns
        return now_ns - self._lost_ns > to_ns(self._parameters.patience_s)

    def _is_contested(self) -> bool:
        since = self._contested_ns
        return since is not None and self._env.clock.now_ns() - since < to_ns(self._parameters.replan_s)

    def _handle(self, path: list[Point2D], pose: Pose2D, *, is_narrow: bool = False) -> Leg:
        """Follow this path to the goal."""
        self._leg = leg = Leg(self._outlet, pose, path, is_narrow=is_narrow)
        self._end = leg.end
        self._planned_ns = self._env.clock.now_ns()
        self._lost_ns = None
        self._travel_claim.restore(leg.path.length_m / self._parameters.speed_m_s)
        return leg

    def _go(self, leg: Leg, encounter: Encounter, pose: Pose2D) -> TravelState:
        """Drive as far as others permit, or aside."""
        if leg.is_escape:
            self._drive(leg, leg.guard(encounter, pose), pose, self._travel_claim.claim)
            return TravelState.WAITING
        now_ns = self._env.clock.now_ns()
        ahead = leg.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M)
        self._travel_claim.relieve(encounter, ahead)
        self._travel_claim.follow(self._leader(encounter))
        allowed = encounter.release(ahead)
        if not allowed.is_whole:
            self._contested_ns = now_ns
            if allowed.by >= 0 and encounter.is_oncoming(allowed.by, ahead):
                self._right_until_ns = now_ns + to_ns(RIGHT_S)
            if now_ns - self._checked_ns > to_ns(self._parameters.replan_blocked_s):
                self._checked_ns = now_ns
                if self._detour(leg, encounter, pose, allowed):
                    return TravelState.MOVING
                if allowed.must_leave:
                    self._escape(leg, encounter, pose, encounter.teammates[allowed.by])
                    self._wait_for(encounter.teammates[allowed.by].name, encounter.passes_in_s(allowed.by, ahead))
                    return TravelState.WAITING
        if self._drive(leg, self._careful(leg, allowed, ahead, now_ns), pose, self._travel_claim.claim):
            names = [teammate.name for teammate in encounter.teammates]
            if self._env.board.waits_for in names:
                self.wait_s = encounter.passes_in_s(names.index(self._env.board.waits_for), ahead)
            return TravelState.WAITING
        if allowed.is_whole or allowed.positions > 2:
            self._wait_for("")
            return TravelState.MOVING
        if allowed.by >= 0:
            self._wait_for(encounter.teammates[allowed.by].name, encounter.passes_in_s(allowed.by, ahead))
        return TravelState.WAITING

    def _drive(self, leg: Leg, allowed: Release, pose: Pose2D, claim: Claim) -> bool:
        """Drive as far as other robots and the areas on the path permit; whether the robot waits before an area."""
        open_positions = self._gate.limit(leg.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M))
        leg.drive(_at_most(allowed, open_positions), claim)
        wait = self._gate.wait
        if wait is None or min(open_positions, allowed.positions) > 2 or open_positions > allowed.positions:
            return False
        others = [robot for robot in wait.robots if robot != self._env.robot]
        self._wait_for(others[0] if others else "", at=wait.at)
        return True

    def _leader(self, encounter: Encounter) -> NearbyRobot | None:
        """The robot by whose claim this one acts: the one before it at an area, or the one behind which it drives.

        A robot that has an area does not act by the claim of one that waits for it.
        """
        wait, leader = self._gate.wait, encounter.leader
        before = wait.robots[-1] if wait is not None and wait.robots else ""
        found = next((one for one in encounter.teammates if one.name == before), leader)
        return None if found is None or found.claim.lent_by == self._env.robot else found

    def _careful(self, leg: Leg, allowed: Release, ahead: Floats, now_ns: int) -> Release:
        """Limit the release to what the map allows, and to small steps after the driver was blocked."""
        if self._lost_ns is not None:
            allowed = _at_most(allowed, self._safe_positions(leg, ahead) - round(NEXT_CHECK_M / STEP_M))
            if allowed.positions > CREEP_POSITIONS:
                self._lost_ns = now_ns  # the view from nearer may differ
        # Small steps keep the driver from cutting corners; one that squeezes does not cut them.
        creeps = now_ns < self._creep_until_ns and not leg.is_narrow
        allowed, zones = _at_most(allowed, CREEP_POSITIONS) if creeps else allowed, self.view().zones
        if zones is not None and not allowed.is_whole:
            allowed = _at_most(allowed, zones.waits_at(ahead[: allowed.positions]))
        return allowed

    def _detour(self, leg: Leg, encounter: Encounter, pose: Pose2D, allowed: Release) -> bool:
        """Take another path if it is at most `detour_m` longer and others hold the robot up clearly less on it."""
        path = None if self._goal is None else self._plan(encounter, self._goal)
        if path is None:
            return False
        other = Leg(self._outlet, pose, path)
        if other.path.length_m > leg.path.left_m + self._parameters.detour_m:
            return False
        allowed_there = encounter.release(other.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M))
        if not allowed_there.is_whole and allowed_there.positions < allowed.positions + round(DETOUR_GAIN_M / STEP_M):
            return False
        self._drive(self._handle(path, pose), allowed_there, pose, self._travel_claim.claim)
        return True

    def _escape(self, leg: Leg, encounter: Encounter, pose: Pose2D, teammate: NearbyRobot) -> None:
        """Leave the path of a teammate with priority, or claim to have nowhere to go."""
        out = self._refuge(encounter, pose, teammate, (False, True) if leg.is_narrow else (False,))
        if out is None:
            self._travel_claim.has_no_refuge(encounter, _here(pose), self._env.clock.now_ns())
            leg.stop(self._travel_claim.claim)
            return
        self._planned_ns = self._env.clock.now_ns()
        self._travel_claim.make_room_for(teammate)
        self._leg = out
        self._drive(out, out.guard(encounter, pose), pose, self._travel_claim.claim)

    def _refuge(
        self, encounter: Encounter, pose: Pose2D, teammate: NearbyRobot, widths: tuple[bool, ...]
    ) -> Leg | None:
        """A path out of a teammate's path, past robots with lower priority if necessary; None if there is none."""
        view, place = self.view(), Point2D(pose.x_m, pose.y_m)
        for is_narrow in widths:
            path = self._planner.escape(view, place, *encounter.to_escape(), is_narrow=is_narrow)
            if path is None:
                pushed = encounter.to_escape(teammate)
                path = self._planner.escape(view, place, *pushed, is_late=True, is_narrow=is_narrow)
            if path is not None:
                return Leg(self._outlet, pose, path, is_escape=True, is_narrow=is_narrow)
        return None

    def _wait_for(self, robot: str, wait_s: float = 0.0, at: str = "") -> None:
        self.wait_s = wait_s
        if robot or at or self._has_reported_wait:  # otherwise the report may be that of another behavior's travel
            self._env.board.waits_for, self._env.board.waits_at = robot, at
        self._has_reported_wait = bool(robot or at)


def _here(pose: Pose2D) -> Floats:
    return np.array([(pose.x_m, pose.y_m)])


def _at_most(allowed: Release, positions: int) -> Release:
    if positions >= allowed.positions:
        return allowed
    return allowed._replace(positions=max(1, positions), is_whole=False)


def too_narrow(travel: Travel) -> tuple[str, dict[str, float]]:
    """Reason why a travel ended with `TOO_NARROW`: in words, and as the result of a task."""
    gap_m, needed_m = travel.gap_m or 0.0, least_gap_m(travel.driver.radius_m())
    result = {GAP: round(gap_m, 3), "needed_m": round(needed_m, 3)}
    return f"the way is too narrow: {gap_m:.2f} m wide, the robot needs {needed_m:.2f} m", result
