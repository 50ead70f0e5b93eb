"""A robot whose behavior `recharge` runs on fakes of battery, charger and task desk."""

from types import SimpleNamespace
from typing import Any

from robrain.agent.robot_tasks import RobotTasks
from robrain.plugins.behavior.budget import BudgetVerdict
from robrain.plugins.behavior.recharge import GUARD_S, RechargeBehavior
from robrain.plugins.behavior.travel import TravelState
from robrain.plugins.skill.energy import Work
from robrain.plugins.skill.home import ChargerPlace
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from tests.plugins.behavior.bare_errand import BareErrand

CHARGER = ChargerPlace(4.0, 0.0, 1.0)
YES = TaskAnswer(accepted=True)
RESERVE_S = 60.0


class BareRecharge:
    """A robot at the origin, with a charger 4 m away; driving takes 20 J per metre, standing 10 J per second."""

    def __init__(self, *chargers: ChargerPlace, start: Point2D | None = None) -> None:
        self.errand = BareErrand(*chargers)
        self.usable_j = 1e6
        self.battery: Any = SimpleNamespace(soc=0.5, charging=False, voltage_v=15.0, current_a=1.0)
        self.ways_home = 0
        self.learned: list[ChargerPlace] = []
        self.tasks = RobotTasks()
        self.tasks.register("explore", lambda _task: YES, lambda _reason: None)
        env = self.errand.env
        env.plugin, env.tasks = "recharge", self.tasks
        env.observe, env.hurry = (lambda _event, _function: None), (lambda: None)
        env.do_tasks = lambda *_arguments: None
        self.board.pose, self.board.battery, self.board.behavior = Pose2D(0.0, 0.0, 0.0), self.battery, "idle"
        budget = self.errand.budget
        budget.judge = self._judge
        budget.path_home = self._way_home
        budget.home = SimpleNamespace(
            chargers=lambda: self.errand.chargers, start=lambda: start, learn=self.learned.append
        )
        self.errand.travel.lost = ""
        self.errand.progress = [TravelState.MOVING] * 50
        self.errand.travel.forget = lambda: None
        self.it = RechargeBehavior(env, RechargeBehavior.Parameters(reserve_s=RESERVE_S))
        self.it.init()
        self.it.travel, self.it.budget = self.errand.travel, budget
        self.it._count = 0

    @property
    def board(self) -> Any:
        return self.errand.board

    def has(self, wait_s: float, path_m: float, spare_j: float = 0.0) -> None:
        """Set the battery to slightly more than this wait and this distance take."""
        self.usable_j = 10.0 * wait_s + 20.0 * path_m + spare_j

    def work_at_a_task(self) -> None:
        self.tasks.offer(
            TaskOffer(task=Task(id="e", kind="explore", place=Point2D(0.0, 0.0)), epoch=1, lease_s=60.0), 0
        )

    def guard(self) -> None:
        """Step to the next check of the energy left."""
        self.errand.wait(GUARD_S)
        self.it.step()

    def _judge(self, work: Work, home_m: float) -> BudgetVerdict:
        return BudgetVerdict(10.0 * work.wait_s + 20.0 * (work.path_m + home_m), self.usable_j, work.wait_s)

    def _way_home(self, place: Point2D) -> tuple[ChargerPlace | None, float]:
        self.ways_home += 1
        if not self.errand.chargers:
            return None, self.start_m
        return self.errand.chargers[0], place.x_m + self.errand.chargers[0].x_m

    start_m = 5.0
