"""Recharge: docks at a charger and stays until the battery is full enough, on request and when it must.

It must charge when another behavior has asked for the path home. It must also charge when the battery's guaranteed
energy falls to the cost of the path home. The running task is then returned, and no other task is accepted before the
energy suffices again.
"""

import math
from collections.abc import Callable, Generator, Sequence
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from robrain.plugins.behavior.budget import AT_DOCK_M, length_m
from robrain.plugins.behavior.errand import STEP_S, Errand, Failed, Part, Run, Script
from robrain.plugins.behavior.travel import TROUBLE, TravelParameters, TravelState
from robrain.plugins.skill.energy import Work
from robrain.plugins.skill.home import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, VISIT, Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of

ASIDE_M = (1.3, 2.0)
"""Distances from a charger at which a robot waits or makes room."""
CLEAR_M = 1.0
"""… and no nearer to any."""
NEAR_M = 3.0
"""A robot this near to a charger waits where it is."""
APART_M = 0.3
"""Distance between the hulls of waiting robots."""
DIRECTIONS = 8
LEFT_OUT_S = 60.0
"""A charger that was of no use is tried again after this."""
GIVEN_S = 20.0
"""Time for which a charger that was given to a teammate counts as the teammate's, wherever it is."""
URGENT_S, SPARE_S, RICH_S = 150.0, 120.0, 600.0
"""A waiting robot that lasts less than the first time gets the charger of one that lasts longer by the second.
Otherwise it gets the charger of one that lasts longer by the third. All chosen: changing places takes some 20 s."""


class Queue:
    """One robot's path to a charger.

    Args:
        errand: the behavior.
        task: its place is the charger that is wanted most.
        yaw_rad: heading of a robot docked there, arena frame; None if it is not known.

    """

    def __init__(self, errand: Errand[Recharge], task: Task, yaw_rad: float | None) -> None:
        self._errand = errand
        self._wanted = ChargerPlace(task.place.x_m, task.place.y_m, yaw_rad)
        self._priority = task.priority
        self._skipped: dict[Point2D, int] = {}
        """Time until which each is skipped."""
        self._given: dict[Point2D, int] = {}
        self._trouble = ""

    def choose(self) -> ChargerPlace | None:
        """The wanted charger if it is free, otherwise the nearest free one; None if others have them all.

        Raises:
            Failed: none is of any use.

        """
        usable = self._usable()
        if not usable:
            raise Failed(self._trouble)
        free = self._free(usable)
        if self._wanted in free or not free:
            return self._wanted if free else None
        return min(self._errand.budget.routes(self._errand.travel.place(), free), key=lambda route: route[1])[0]

    def leave_out(self, charger: ChargerPlace, reason: str) -> None:
        """Skip a useless charger for a while."""
        self._trouble = reason
        self._skipped[charger.place] = self._now_ns() + to_ns(LEFT_OUT_S)

    def reach(self, charger: ChargerPlace) -> Script:
        """Go there.

        Whether the robot is there; False if another robot has it now, or there is no path.
        """
        errand = self._errand
        if not errand.travel.set_out(charger.place, priority=self._priority):
            self.leave_out(charger, TROUBLE[TravelState.NO_PATH])
            return {}
        while (progress := errand.travel.step()) is not TravelState.ARRIVED:
            if progress in TROUBLE:
                self.leave_out(charger, TROUBLE[progress])
            if progress in TROUBLE or errand.budget.docks.holder(charger.place):
                errand.travel.stop()
                return {}
            yield
        yield from errand.settle()
        return {"reached": True}

    def wait(self) -> Part:
        """Stand near a usable charger, off all paths, until one is free: its robot gives way to one that waits near."""
        yield from self.move_aside(self._usable())
        while (usable := self._usable()) and not self._free(usable):
            self._errand.travel.make_room()
            yield
        self._errand.travel.stop()

    def must_give(self, charger: ChargerPlace) -> bool:
        """Whether a waiting teammate needs a charger more, and this robot is the charging one that needs it least."""
        errand = self._errand
        energy = errand.env.board.energy
        chargers = self._known()
        waiting = errand.budget.docks.waiting(chargers)
        if not waiting or energy is None:
            return False
        mine = (energy.usable_j / max(energy.usual_power_w, 0.1), errand.env.robot)
        if any((teammate.endurance_s, teammate.name) > mine for teammate in errand.budget.docks.charging(chargers)):
            return False
        neediest_s = min(teammate.endurance_s for teammate in waiting)
        return mine[0] >= neediest_s + (SPARE_S if neediest_s < URGENT_S else RICH_S)

    def give_up_place(self, charger: ChargerPlace) -> Part:
        """Leave the charger to the waiting robot."""
        self._given[charger.place] = self._now_ns() + to_ns(GIVEN_S)
        yield from self.move_aside()

    def move_aside(self, beside: Sequence[ChargerPlace] = ()) -> Script:
        """Go near one of these chargers, or of all, where others get to every charger, if the robot is not there."""
        place = self._aside(beside or self._known())
        if place is not None:
            try:
                yield from self._errand.go(place)
            except Failed:
                self._errand.travel.stop()  # here, then
        return {}

    def _aside(self, beside: Sequence[ChargerPlace]) -> Point2D | None:
        """The nearest place with room beside one of these chargers; None if the robot need not, or cannot, go there."""
        travel, chargers = self._errand.travel, self._known()
        pose = travel.pose()
        nearest = min(beside, key=lambda charger: pose.distance_m(charger.place))
        if pose.distance_m(nearest.place) <= NEAR_M and min(pose.distance_m(one.place) for one in chargers) >= CLEAR_M:
            return None
        radius_m = travel.driver.radius_m()
        occupied = [(charger.place, CLEAR_M) for charger in chargers]
        for teammate in travel.teammates.nearby(travel.place(), travel.teammate_near_m):
            occupied.append((Point2D(teammate.pose.x_m, teammate.pose.y_m), radius_m + teammate.radius_m + APART_M))
            occupied.append((teammate.bound, radius_m + teammate.radius_m + APART_M))
        places = [
            Point2D(nearest.x_m + away_m * math.cos(angle_rad), nearest.y_m + away_m * math.sin(angle_rad))
            for away_m in ASIDE_M
            for angle_rad in (direction * math.tau / DIRECTIONS for direction in range(DIRECTIONS))
        ]
        clear = [place for place in places if all(place.distance_m(other) >= apart_m for other, apart_m in occupied)]
        for place in sorted(clear, key=pose.distance_m):
            path = travel.plan(place)
            if path and path[-1].distance_m(place) < APART_M:
                return place
        return None

    def _known(self) -> list[ChargerPlace]:
        others = self._errand.budget.home.chargers()
        return [self._wanted, *(each for each in others if each.place.distance_m(self._wanted.place) > AT_DOCK_M)]

    def _usable(self) -> list[ChargerPlace]:
        now_ns = self._now_ns()
        return [charger for charger in self._known() if self._skipped.get(charger.place, 0) <= now_ns]

    def _free(self, chargers: list[ChargerPlace]) -> list[ChargerPlace]:
        now_ns = self._now_ns()
        ours = [charger for charger in chargers if self._given.get(charger.place, 0) <= now_ns]
        return self._errand.budget.docks.free(ours)

    def _now_ns(self) -> int:
        return self._errand.env.clock.now_ns()


DOCKED_M = 0.05
DOCK_TRIES = 3
TOUCH_S = 2.0
"""Time that a docked robot waits for the first current before it searches around for the contacts."""
SEEK_RINGS = ((0.2, 6), (0.4, 8), (0.6, 12))
"""Search for a dock that is not quite in its place: metres around it, and number of places. As dense as is needed for
contacts that reach 0.25 m."""
SEEK_WAIT_S = 1.2
SEEK_BLOCKED_S = 0.6
GIVE_S = 2.0
"""Period of the checks whether a teammate needs the charger more."""


class Docking:
    """At one charger.

    Args:
        errand: the behavior.
        charger: where.
        no_power_s: time without current after which a charger counts as useless.

    """

    def __init__(self, errand: Errand[Any], charger: ChargerPlace, no_power_s: float) -> None:
        self._errand = errand
        self._charger = charger
        self._no_power_ns = to_ns(no_power_s)
        self.has_charged = False
        """A current has come."""

    def dock(self) -> Part:
        """Stand at the charger's place by localisation; the current decides in the end."""
        for _ in range(DOCK_TRIES):
            self._set_out(self._charger.place)
            yield from self._errand.arrive("the robot does not get into the dock")
            if self._errand.away_m(self._charger.place) <= DOCKED_M:
                break
        yield from self._feel(TOUCH_S)

    def charge(self, until_soc: float, must_give: Callable[[ChargerPlace], bool]) -> Generator[None, None, bool]:
        """Stay until there is enough, or no current for a while; True if a teammate is to get the place."""
        clock = self._errand.env.clock
        has_sought, last_ns = False, clock.now_ns()
        check_ns = last_ns
        while (battery := self._errand.battery()).soc < until_soc:
            now_ns = clock.now_ns()
            if battery.charging:
                self.has_charged, last_ns = True, now_ns
                if now_ns >= check_ns:
                    check_ns = now_ns + to_ns(GIVE_S)
                    if must_give(self._charger):
                        return True
            elif not self.has_charged and not has_sought:
                has_sought = True
                yield from self._seek()
                last_ns = clock.now_ns()
            elif now_ns - last_ns > self._no_power_ns:
                return False
            yield
        return False

    def _seek(self) -> Part:
        """Try places around the dock, from the inside out."""
        place, driver = self._charger.place, self._errand.travel.driver
        for radius_m, places in SEEK_RINGS:
            for index in range(places):
                angle_rad = index * math.tau / places
                self._set_out(
                    Point2D(place.x_m + radius_m * math.cos(angle_rad), place.y_m + radius_m * math.sin(angle_rad))
                )
                yield
                while driver.motion() is not Motion.STOPPED and driver.blocked_s() < SEEK_BLOCKED_S:
                    yield
                if driver.motion() is not Motion.STOPPED:  # there is something there
                    driver.stop()
                    continue
                yield from self._feel(SEEK_WAIT_S)
                if self._errand.battery().charging:
                    return

    def _feel(self, seconds: float) -> Part:
        """Stand until a current comes, for this time at most."""
        until_ns = self._errand.env.clock.now_ns() + to_ns(seconds)
        while self._errand.env.clock.now_ns() < until_ns and not self._errand.battery().charging:
            yield

    def _set_out(self, place: Point2D) -> None:
        travel = self._errand.travel
        T_arena_odom = self._errand.env.board.T_arena_odom
        if T_arena_odom is None:
            raise Failed("the robot does not know where it is")
        yaw_rad = self._charger.yaw_rad
        facing_rad = yaw_rad if yaw_rad is not None else travel.pose().yaw_rad
        at = T_arena_odom.inverse().compose(Pose2D(place.x_m, place.y_m, facing_rad))
        travel.driver.go_to(at.x_m, at.y_m, at.yaw_rad)


GUARD_S = 2.0
"""Period of the checks whether the robot still can get home."""
AT_HOME_M = 1.0
"""A robot without a known charger is at home within this distance of its start."""
FULL_ERROR = 0.06
"""Largest error of the estimate of a full battery. Chosen: about three deviations of it."""
RETRY_NS = to_ns(20.0)
"""Time between a failed path home and the next try."""
HOMEWARD = 10.0
"""Priority, where robots meet, of a robot with just enough energy for the path home."""
DOCK_S = 10.0
"""Approximate time of docking."""
QUEUE_S = 180.0
"""While others occupy all chargers, the robot also keeps the energy for standing this time. Chosen."""


class RechargeBehavior(Errand[Recharge]):
    """Docks at a charger and charges the robot."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When the robot goes to charge by itself, and how long it stays; chosen."""

        reserve_s: Positive = 60.0
        """Energy kept beyond the path home, as time of standing."""
        until_soc: Annotated[float, Meta(gt=0, le=1)] = 0.95
        no_power_s: Positive = 10.0
        """A charger without current for this long counts as useless."""

    kind = RECHARGE
    idle_period_s: ClassVar[float | None] = GUARD_S
    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._wanted = ""
        """Reason why the robot must go home by itself; empty if it need not."""
        self._charged_j = 0.0
        self._not_before_ns = 0
        self._home_m = 0.0
        self._home_from: Point2D | None = None
        """Place at which the path home had this length."""
        self._home_free: list[ChargerPlace] = []
        """The chargers that were free then."""

    def activate(self) -> None:
        super().activate()
        self._count = self.env.clock.now_ns() // to_ns(0.001)
        self.env.observe(self.budget.home.asked, self._ask)

    def emergency_halt(self) -> None:
        self._wanted = ""
        super().emergency_halt()

    def work(self, task: Task, parameters: Recharge) -> Work:
        """Docking; energy used at the charger comes from the charger."""
        return Work(wait_s=DOCK_S)

    def left_s(self, run: Run[Recharge]) -> float | None:
        """Unknown: others may have the charger."""
        return None

    def play(self, task: Task, parameters: Recharge) -> Script:
        """Go to a free charger, and to the next if that one is of no use; wait while there is none."""
        self._queue = Queue(self, task, parameters.yaw_rad)
        self._charged_j = 0.0
        while True:
            charger = self._queue.choose()
            if charger is None:
                yield from self._queue.wait()
            elif (yield from self._queue.reach(charger)):
                while self.env.clock.now_ns() < task.earliest_ns:
                    yield
                if self.run is not None:
                    self.run.there_ns = self.env.clock.now_ns()
                try:
                    result = yield from self.charge_at(charger, parameters.until_soc)
                except Failed as failed:
                    self._queue.leave_out(charger, str(failed))
                    continue
                if result:
                    return result
                yield from self._queue.give_up_place(charger)

    def do(self, task: Task, parameters: Recharge) -> Script:
        """Dock and charge at the task's place."""
        charger = ChargerPlace(task.place.x_m, task.place.y_m, parameters.yaw_rad)
        return (yield from self.charge_at(charger, parameters.until_soc))

    def charge_at(self, charger: ChargerPlace, until_soc: float) -> Script:
        """Dock and charge; the result is empty if a teammate needs the charger more.

        Result: `soc`; `docked_m`, the robot's distance from the charger; `charged_j`, the energy from the charger.
        """
        docking = Docking(self, charger, self.parameters.no_power_s)
        yield from docking.dock()
        docked_m = self.away_m(charger.place)
        begun_soc = self.battery().soc
        if (yield from docking.charge(until_soc, self._queue.must_give)):
            return {}
        soc = self.battery().soc
        # A battery may be full before its estimate is; a charge that stops early is another case.
        has_come = docking.has_charged or begun_soc >= until_soc
        if soc < until_soc - FULL_ERROR or not has_come:
            if docking.has_charged:
                raise Failed(f"the charger has stopped at {soc:.0%}")
            raise Failed(f"the charger gives nothing, {docked_m:.2f} m from its place")
        return {"soc": round(soc, 3), "docked_m": round(docked_m, 3), "charged_j": round(self._charged_j, 1)}

    def _measure(self, run: Run[Recharge]) -> None:
        """Energy used at the charger comes from the charger; `energy_j` is the cost of the path to it."""
        before_j = run.energy_j
        super()._measure(run)
        battery = self.env.board.battery
        if battery is not None and battery.charging:
            self._charged_j += before_j - run.energy_j
            run.energy_j = before_j

    def refusal(self, run: Run[Recharge]) -> None:
        """Nothing: running out of energy on the path to a charger is no worse than waiting for it."""

    def homing_reason(self, run: Run[Recharge]) -> None:
        """Nothing: the robot already drives there."""

    def accept(self, task: Task) -> TaskAnswer:
        """Accept a task; its charger is known from now on."""
        answer = super().accept(task)
        if answer.accepted:
            self._wanted = ""
            self.budget.home.learn(ChargerPlace(task.place.x_m, task.place.y_m, parameters_of(task, Recharge).yaw_rad))
        return answer

    def step(self) -> None:
        now_ns = self.env.clock.now_ns()
        if self.run is None and now_ns >= self._not_before_ns:
            self._not_before_ns = now_ns + to_ns(GUARD_S)
            self._guard()
        if self.run is None and self._wanted:
            self._set_out_home()
        elif self.run is None:
            self._clear_charger()
        super().step()
        if self._wanted:
            self.period_s = STEP_S

    def ended_own(self, state: TaskState, reason: str) -> None:
        """Try again after a while, if a charge is still necessary then."""
        if state is not TaskState.DONE:
            self._not_before_ns = self.env.clock.now_ns() + RETRY_NS

    def _ask(self, reason: str) -> None:
        if self.run is None:
            self._wanted = reason
            self.period_s = STEP_S
            self._set_out_home()

    def _guard(self) -> None:
        battery = self.env.board.battery
        if self._wanted or battery is None or battery.charging or self.env.board.pose is None:
            return
        pose = self.travel.pose()
        # A task was begun with only the path home to spare: only an idle robot keeps a reserve too.
        wait_s = 0.0 if self.env.tasks.is_busy else self.parameters.reserve_s
        chargers = self.budget.home.chargers()
        free = self.budget.docks.free(chargers)
        if chargers and not free:
            wait_s += QUEUE_S
        reserve = Work(wait_s=wait_s)
        if free != self._home_free:
            self._home_from, self._home_free = None, free
        if self._home_from is not None:
            # The path home is at most the earlier one plus the path from there; mostly this bound suffices.
            bound_m = self._home_m + pose.distance_m(self._home_from)
            if self.budget.judge(reserve, bound_m).is_affordable:
                return
        self._home_from = Point2D(pose.x_m, pose.y_m)
        charger, self._home_m = self.budget.path_home(self._home_from)
        verdict = self.budget.judge(reserve, self._home_m)
        if verdict.is_affordable or (charger is None and self._home_m < AT_HOME_M):
            return
        self._wanted = f"the way home {verdict.words}"
        if self.env.tasks.is_busy:
            self.env.tasks.recall(verdict.reason)

    def _clear_charger(self) -> None:
        """Leave a charger that the robot no longer needs, when a teammate waits for one."""
        chargers = self.budget.home.chargers()
        if not chargers or self.env.tasks.is_busy or self.env.board.pose is None or self.travel.lost:
            return
        pose = self.travel.pose()
        is_at_one = any(pose.distance_m(charger.place) <= AT_DOCK_M for charger in chargers)
        if is_at_one and self.budget.docks.waiting(chargers) and self.env.tasks.occupy(self.env.plugin):
            here = self.travel.place()
            task = Task(id=f"aside-{self.env.robot}", kind=VISIT, place=here)
            queue = Queue(self, task, None)
            self.accept_task(Run(task, Recharge(), queue.move_aside, here, 0.0, 0.0, own="make room"))

    def _set_out_home(self) -> None:
        """Go to the nearest charger, or where the robot started; later, if a task has yet to be given back."""
        if self.env.tasks.is_busy:
            return
        here = self.travel.place()
        charger, _ = self.budget.path_home(here)
        goal = charger.place if charger is not None else self.budget.home.start()
        path = None if goal is None else self.travel.plan(goal)
        reason, self._wanted = self._wanted, ""
        if goal is None or path is None:
            self._not_before_ns = self.env.clock.now_ns() + RETRY_NS
            return
        if not self.env.tasks.occupy(self.env.plugin, firm=f"{self.env.robot} goes home: {reason}"):
            return
        self._count += 1
        name = f"home-{self.env.robot}-{self._count}"
        path_m = length_m([here, *path])
        if charger is not None:
            wanted = Recharge(yaw_rad=charger.yaw_rad, until_soc=self.parameters.until_soc)
            task = Task(id=name, kind=RECHARGE, place=goal, priority=HOMEWARD, parameters=wanted.json)
            self.accept_task(Run(task, wanted, lambda: self.play(task, wanted), goal, path_m, 0.0, own="recharge"))
        else:
            task = Task(id=name, kind=VISIT, place=goal, priority=HOMEWARD)
            self.accept_task(Run(task, Recharge(), lambda: self._return(goal), goal, path_m, 0.0, own="go home"))

    def _return(self, goal: Point2D) -> Script:
        yield from self.go(goal)
        return {}
