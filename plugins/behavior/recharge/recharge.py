"""Recharge: docks at a charger and stays until the battery is full enough, when told and when it must.

It must when another behavior has asked for the way home, or when what the battery surely gives comes down to what the
way home takes: the running task is given back then, and no other is taken on before there is enough again.
"""

import math
from typing import Any, ClassVar

from robrain.plugins.behavior.budget import length_m
from robrain.plugins.behavior.errand import STEP_S, Errand, Failed, Part, Run, Script
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.skill.energy.interface import Work
from robrain.plugins.skill.home.interface import ChargerPlace
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.task import Recharge, TaskState, Visit
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages import BatteryState, TaskAnswer

GUARD_S = 2.0
"""How often it is looked whether the robot still can get home."""
AT_HOME_M = 1.0
"""So near to where it started a robot that knows no charger is at home."""
DOCKED_M = 0.05
DOCK_TRIES = 3
SEEK_M, SEEK_PLACES, SEEK_WAIT_S = 0.15, 6, 1.5
"""Where a dock is looked for that is not quite in its place, and how long each is tried."""
FULL_ERROR = 0.06
"""The estimate of a full battery may be off by so much. Chosen: about three deviations of it."""
RETRY_NS = to_ns(20.0)
"""After a way home that failed, the next try comes this much later."""
HOMEWARD = 10.0
"""Priority of who has just enough for the way home, where robots meet."""
DOCK_S = 10.0
"""What docking takes, about."""


class RechargeBehavior(Errand):
    """Charges the robot."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When the robot goes to charge of its own accord, and how long it stays; chosen."""

        reserve_s: float = 60.0
        """Beside the way home, it keeps what standing for so long takes."""
        until_soc: float = 0.95
        no_power_s: float = 10.0
        """A charger that has given nothing for so long gives nothing."""

        def __post_init__(self) -> None:
            super().__post_init__()
            for name in ("reserve_s", "no_power_s"):
                if not getattr(self, name) > 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
            if not 0 < self.until_soc <= 1:
                raise ValueError(f"expected until_soc above 0 and at most 1, got {self.until_soc}")

    kind = Recharge
    idle_period_s: ClassVar[float | None] = GUARD_S
    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._wanted = ""
        """Why the robot is to go home of its own accord; empty if it need not."""
        self._not_before_ns = 0
        self._home_m = 0.0
        self._home_from: Point2D | None = None
        """Where the way home was that long."""

    def activate(self) -> None:
        super().activate()
        self._count = self.env.clock.now_ns() // to_ns(0.001)
        self.env.observe(self.budget.home.asked, self._ask)

    def emergency_halt(self) -> None:
        self._wanted = ""
        super().emergency_halt()

    # -- at the charger -------------------------------------------------------------------------------------

    def work(self, task: Any) -> Work:
        """Docking; what is used at the charger comes from the charger."""
        return Work(wait_s=DOCK_S)

    def do(self, task: Recharge) -> Script:
        """Dock and charge. Result: `soc`, `docked_m`, how far from the place it stood."""
        yield from self._dock(task)
        docked_m = self.away_m(task.place)
        begun_soc = self._battery().soc
        yield from self._charge(task)
        battery = self._battery()
        # A battery may be full before the estimate of it says so; one that stops on the way is another matter.
        if battery.soc < task.until_soc - FULL_ERROR:
            if battery.soc > begun_soc:
                raise Failed(f"the charger has stopped at {battery.soc:.0%}")
            raise Failed(f"the charger gives nothing, {docked_m:.2f} m from its place")
        return {"soc": round(battery.soc, 3), "docked_m": round(docked_m, 3)}

    def _charge(self, task: Recharge) -> Part:
        """Stay until there is enough, or nothing has come for a while; a dock that is not quite there is looked for."""
        has_charged, last_ns = False, self.env.clock.now_ns()
        while (battery := self._battery()).soc < task.until_soc:
            now_ns = self.env.clock.now_ns()
            if battery.charging:
                has_charged, last_ns = True, now_ns
            elif now_ns - last_ns > to_ns(self.parameters.no_power_s):
                if not has_charged:
                    yield from self._seek(task)
                if has_charged or not self._battery().charging:
                    return
            yield

    def _seek(self, task: Recharge) -> Part:
        """Try places around the dock: where the robot believes to be is some centimetres off."""
        for index in range(SEEK_PLACES):
            angle_rad = index * math.tau / SEEK_PLACES
            aside = Point2D(
                task.place.x_m + SEEK_M * math.cos(angle_rad), task.place.y_m + SEEK_M * math.sin(angle_rad)
            )
            yield from self._approach(aside, task.yaw_rad)
            yield from self.wait(SEEK_WAIT_S)
            if self._battery().charging:
                return

    def _dock(self, task: Recharge) -> Part:
        for _ in range(DOCK_TRIES):
            yield from self._approach(task.place, task.yaw_rad)
            if self.away_m(task.place) <= DOCKED_M:
                return
        raise Failed(f"docked {self.away_m(task.place):.2f} m from the charger's place, not within {DOCKED_M:g} m")

    def _approach(self, place: Point2D, yaw_rad: float | None) -> Part:
        T_arena_odom = self.env.board.T_arena_odom
        if T_arena_odom is None:
            raise Failed("the robot does not know where it is")
        facing_rad = yaw_rad if yaw_rad is not None else self.travel.pose().yaw_rad
        at = T_arena_odom.inverse().compose(Pose2D(place.x_m, place.y_m, facing_rad))
        self.travel.driver.go_to(at.x_m, at.y_m, at.yaw_rad)
        yield from self.stand("the robot does not get into the dock")

    def _battery(self) -> BatteryState:
        battery = self.env.board.battery
        if battery is None:
            raise Failed("the battery says nothing")
        return battery

    # -- told to --------------------------------------------------------------------------------------------

    def why_not(self, run: Run) -> str:
        """Nothing: to run out of energy on the way to a charger is no worse than to wait for it."""
        return ""

    def why_go_home(self, run: Run) -> str:
        """Nothing: it is on its way."""
        return ""

    def accept(self, task: Recharge) -> TaskAnswer:
        """Take on a task; its charger is known from now on."""
        answer = super().accept(task)
        if answer.accepted:
            self._wanted = ""
            self.budget.home.learn(ChargerPlace(task.place.x_m, task.place.y_m, task.yaw_rad))
        return answer

    # -- of its own accord ----------------------------------------------------------------------------------

    def step(self) -> None:
        if self.run is None and self.env.clock.now_ns() >= self._not_before_ns:
            self._not_before_ns = self.env.clock.now_ns() + to_ns(GUARD_S)
            self._guard()
        if self.run is None and self._wanted:
            self._set_out_home()
        super().step()
        if self._wanted:
            self.period_s = STEP_S

    def ended_own(self, state: TaskState, why: str) -> None:
        """Try again after a while, if it still is needed then."""
        if state is not TaskState.DONE:
            self._not_before_ns = self.env.clock.now_ns() + RETRY_NS

    def _ask(self, why: str) -> None:
        if self.run is None:
            self._wanted = why
            self.period_s = STEP_S
            self._set_out_home()

    def _guard(self) -> None:
        battery = self.env.board.battery
        if self._wanted or battery is None or battery.charging or self.env.board.pose is None:
            return
        pose = self.travel.pose()
        # A task was begun with no more than the way home to spare: only what has nothing to do keeps a reserve too.
        reserve = Work(wait_s=0.0 if self.env.tasks.is_busy else self.parameters.reserve_s)
        if self._home_from is not None:
            # The way home is at the most what it was, and the way from there; mostly that is enough to know.
            bound_m = self._home_m + pose.distance_m(self._home_from)
            if self.budget.judge(reserve, bound_m).is_affordable:
                return
        self._home_from = Point2D(pose.x_m, pose.y_m)
        charger, self._home_m = self.budget.way_home(self._home_from)
        verdict = self.budget.judge(reserve, self._home_m)
        if verdict.is_affordable or (charger is None and self._home_m < AT_HOME_M):
            return
        self._wanted = f"the way home {verdict.words}"
        if self.env.tasks.is_busy:
            self.env.tasks.recall(self._wanted)

    def _set_out_home(self) -> None:
        """Go to the nearest charger, or where the robot started; later, if a task has yet to be given back."""
        if self.env.tasks.is_busy:
            return
        pose = self.travel.pose()
        here = Point2D(pose.x_m, pose.y_m)
        charger, _ = self.budget.way_home(here)
        goal = charger.place if charger is not None else self.budget.home.start()
        path = None if goal is None else self.travel.plan(goal)
        why, self._wanted = self._wanted, ""
        if goal is None or path is None:
            self._not_before_ns = self.env.clock.now_ns() + RETRY_NS
            return
        if not self.env.tasks.occupy(self.env.plugin, firm=f"{self.env.robot} goes home: {why}"):
            return
        self._count += 1
        name = f"home-{self.env.robot}-{self._count}"
        way_m = length_m([here, *path])
        if charger is not None:
            task = Recharge(
                id=name,
                place=goal,
                priority=HOMEWARD,
                yaw_rad=charger.yaw_rad,
                until_soc=self.parameters.until_soc,
            )
            self.take_on(Run(task, self.play(task, goal), goal, way_m, 0.0, own="recharge"))
        else:
            self.take_on(
                Run(Visit(id=name, place=goal, priority=HOMEWARD), self._return(goal), goal, way_m, 0.0, own="go home")
            )

    def _return(self, goal: Point2D) -> Script:
        yield from self.go(goal)
        return {}
