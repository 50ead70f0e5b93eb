"""Recharge: docks at a charger and stays until the battery is full enough, when told and when it must.

It must when another behavior has asked for the way home, or when what the battery surely gives comes down to what the
way home takes: the running task is given back then, and no other is taken on before there is enough again.
"""

from typing import ClassVar

from robrain.plugins.behavior.budget import AT_DOCK_M, length_m
from robrain.plugins.behavior.errand import STEP_S, Errand, Failed, Run, Script
from robrain.plugins.behavior.recharge.docking import Docking
from robrain.plugins.behavior.recharge.queue import Queue
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.skill.energy.interface import Work
from robrain.plugins.skill.home.interface import ChargerPlace
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, VISIT, Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.tasks.offer_messages import TaskAnswer

GUARD_S = 2.0
"""How often it is looked whether the robot still can get home."""
AT_HOME_M = 1.0
"""So near to where it started a robot that knows no charger is at home."""
FULL_ERROR = 0.06
"""The estimate of a full battery may be off by so much. Chosen: about three deviations of it."""
RETRY_NS = to_ns(20.0)
"""After a way home that failed, the next try comes this much later."""
HOMEWARD = 10.0
"""Priority of who has just enough for the way home, where robots meet."""
DOCK_S = 10.0
"""What docking takes, about."""
QUEUE_S = 180.0
"""As long as others have all the chargers, it keeps what standing for so long takes as well. Chosen."""


class RechargeBehavior(Errand[Recharge]):
    """Docks at a charger and charges the robot."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When the robot goes to charge by itself, and how long it stays; chosen."""

        reserve_s: float = 60.0
        """Energy kept beyond the way home, as time of standing."""
        until_soc: float = 0.95
        no_power_s: float = 10.0
        """A charger without current for this long counts as useless."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_positive(self, "reserve_s", "no_power_s")
            if not 0 < self.until_soc <= 1:
                raise ValueError(f"expected until_soc above 0 and at most 1, got {self.until_soc}")

    kind = RECHARGE
    idle_period_s: ClassVar[float | None] = GUARD_S
    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._wanted = ""
        """Why the robot is to go home by itself; empty if it need not."""
        self._charged_j = 0.0
        self._not_before_ns = 0
        self._home_m = 0.0
        self._home_from: Point2D | None = None
        """Where the way home was that long."""
        self._home_free: list[ChargerPlace] = []
        """The chargers that nobody had then."""

    def activate(self) -> None:
        super().activate()
        self._count = self.env.clock.now_ns() // to_ns(0.001)
        self.env.observe(self.budget.home.asked, self._ask)

    def emergency_halt(self) -> None:
        self._wanted = ""
        super().emergency_halt()

    def work(self, task: Task, parameters: Recharge) -> Work:
        """Docking; what is used at the charger comes from the charger."""
        return Work(wait_s=DOCK_S)

    def left_s(self, run: Run[Recharge]) -> float | None:
        """Nobody knows: others may have the charger."""
        return None

    def play(self, task: Task, parameters: Recharge) -> Script:
        """To a charger that nobody else has, and to the next if that one is of no use; waits while there is none."""
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
        """Dock and charge where the task says."""
        charger = ChargerPlace(task.place.x_m, task.place.y_m, parameters.yaw_rad)
        return (yield from self.charge_at(charger, parameters.until_soc))

    def charge_at(self, charger: ChargerPlace, until_soc: float) -> Script:
        """Dock and charge; no result if a mate needs the charger more.

        Result: `soc`; `docked_m`, how far from the place it stood; `charged_j`, what came from the charger.
        """
        docking = Docking(self, charger, self.parameters.no_power_s)
        yield from docking.dock()
        docked_m = self.away_m(charger.place)
        begun_soc = self.battery().soc
        if (yield from docking.charge(until_soc, self._queue.must_give)):
            return {}
        soc = self.battery().soc
        # A battery may be full before the estimate of it says so; one that stops on the way is another matter.
        has_come = docking.has_charged or begun_soc >= until_soc
        if soc < until_soc - FULL_ERROR or not has_come:
            if docking.has_charged:
                raise Failed(f"the charger has stopped at {soc:.0%}")
            raise Failed(f"the charger gives nothing, {docked_m:.2f} m from its place")
        return {"soc": round(soc, 3), "docked_m": round(docked_m, 3), "charged_j": round(self._charged_j, 1)}

    def _measure(self, run: Run[Recharge]) -> None:
        """What is used at the charger comes from the charger: `energy_j` is what the way to it has cost."""
        before_j = run.energy_j
        super()._measure(run)
        battery = self.env.board.battery
        if battery is not None and battery.charging:
            self._charged_j += before_j - run.energy_j
            run.energy_j = before_j

    def why_not(self, run: Run[Recharge]) -> None:
        """Nothing: to run out of energy on the way to a charger is no worse than to wait for it."""

    def why_go_home(self, run: Run[Recharge]) -> str:
        """Nothing: it is on its way."""
        return ""

    def accept(self, task: Task) -> TaskAnswer:
        """Take on a task; its charger is known from now on."""
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
            self._make_way()
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
        wait_s = 0.0 if self.env.tasks.is_busy else self.parameters.reserve_s
        chargers = self.budget.home.chargers()
        free = self.budget.docks.free(chargers)
        if chargers and not free:
            wait_s += QUEUE_S
        reserve = Work(wait_s=wait_s)
        if free != self._home_free:
            self._home_from, self._home_free = None, free
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

    def _make_way(self) -> None:
        """Leave a charger that the robot does not need any more, when a mate waits for one."""
        chargers = self.budget.home.chargers()
        if not chargers or self.env.tasks.is_busy or self.env.board.pose is None or self.travel.lost:
            return
        pose = self.travel.pose()
        is_at_one = any(pose.distance_m(charger.place) <= AT_DOCK_M for charger in chargers)
        if is_at_one and self.budget.docks.waiting(chargers) and self.env.tasks.occupy(self.env.plugin):
            here = Point2D(pose.x_m, pose.y_m)
            task = Task(id=f"aside-{self.env.robot}", kind=VISIT, place=here)
            queue = Queue(self, task, None)
            self.take_on(Run(task, Recharge(), queue.stand_aside, here, 0.0, 0.0, own="make room"))

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
            wanted = Recharge(yaw_rad=charger.yaw_rad, until_soc=self.parameters.until_soc)
            task = Task(id=name, kind=RECHARGE, place=goal, priority=HOMEWARD, parameters=wanted.json)
            self.take_on(Run(task, wanted, lambda: self.play(task, wanted), goal, way_m, 0.0, own="recharge"))
        else:
            task = Task(id=name, kind=VISIT, place=goal, priority=HOMEWARD)
            self.take_on(Run(task, Recharge(), lambda: self._return(goal), goal, way_m, 0.0, own="go home"))

    def _return(self, goal: Point2D) -> Script:
        yield from self.go(goal)
        return {}
