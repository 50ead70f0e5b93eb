"""Explore: goes to the frontier that the coordinator assigns, until no unknown floor remains around it.

Without a coordinator the robot chooses frontiers for itself, with regard to the other robots (`team_choice.py`). A
robot that does not know its place, and maps in its own frame, goes to the nearest frontier (Yamauchi 1997).
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from robrain.agent.board import HALTED, IDLE, Board
from robrain.agent.plugin import Behavior, external
from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.reach import reach_m
from robrain.algorithms.exploration.situation import Busy
from robrain.algorithms.exploration.strategies import JOINT, NO_EXPLORATION, STRATEGIES, Strategy, strategy_of
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.clearance import mapped_gap_cells
from robrain.algorithms.navigation.frontier import MIN_CELLS, find_frontiers, frontier_mask, touching
from robrain.plugins.behavior.travel import FIND_ITSELF, GAP, TROUBLE, Travel, TravelParameters, TravelState, too_narrow
from robrain.plugins.skill.mapper.mapper import MapCells
from robrain.plugins.unit.teammates import Doing, NearbyRobot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import Name, Share
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, TaskParameters
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import PositionLost, no_path

CONFIDENCE = 0.95
"""One-sided, of the energy that a path takes: that of plans."""
ALONE = "explore alone"
"""Board text for a robot that explores by its own choice."""


class OwnFloor:
    """The robot's knowledge about the floor.

    Args:
        board: the robot's board.

    """

    def __init__(self, board: Board) -> None:
        self._board = board

    @property
    def grid(self) -> OccupancyGrid | None:
        """The map; None before anything is known."""
        return self._board.map

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        return 0 if self._board.map is None else self._board.map.version


class TeamChoice(Explorer):
    """Chooses frontiers for a robot that receives its teammates and no coordinator.

    Args:
        robot: its name.
        board: the robot's board.
        strategy: which robot is sent to which frontier; the same for all robots of the team.
        reserve_share: share of the battery that the robot keeps on its path to a frontier and on to a charger.

    """

    def __init__(self, robot: str, board: Board, strategy: Strategy, reserve_share: float) -> None:
        super().__init__(OwnFloor(board), strategy)
        self._robot, self._board, self._reserve_share = robot, board, reserve_share

    def choose_own(
        self, place: Point2D, radius_m: float, goal: Point2D | None, teammates: Sequence[NearbyRobot], now_ns: int
    ) -> Point2D | None:
        """The frontier to go to, arena frame; None if there is none, or the robot is to keep the one it has.

        Args:
            place: where the robot is.
            radius_m: its radius.
            goal: the frontier to which it drives; None if it has none.
            teammates: the other robots.
            now_ns: the time.

        """
        scouts = [
            self._own(place, radius_m, goal),
            *(_scout(teammate) for teammate in teammates if _explores(teammate)),
        ]
        busy = [
            Busy(Point2D(teammate.pose.x_m, teammate.pose.y_m), teammate.bound)
            for teammate in teammates
            if teammate.doing is not Doing.OBSTACLE and not _explores(teammate)
        ]
        chosen = self.choose(sorted(scouts), busy, now_ns)
        return next((choice.place for choice in chosen if choice.robot == self._robot), None)

    def _own(self, place: Point2D, radius_m: float, goal: Point2D | None) -> Scout:
        """The robot itself, with the reach of its energy; the reach of others is unknown here."""
        board, homes = self._board, self._board.chargers
        far_m = math.inf
        if homes:
            far_m = reach_m(board.energy, board.battery, reserve_share=self._reserve_share, confidence=CONFIDENCE)
        return Scout(self._robot, place, radius_m, goal, far_m, homes)


def _explores(teammate: NearbyRobot) -> bool:
    """Whether a teammate chooses its goal by itself as well, and may yet choose another."""
    return teammate.doing is not Doing.OBSTACLE and teammate.behavior in (ALONE, IDLE)


def _scout(teammate: NearbyRobot) -> Scout:
    place = Point2D(teammate.pose.x_m, teammate.pose.y_m)
    return Scout(teammate.name, place, teammate.radius_m, teammate.bound if teammate.behavior == ALONE else None)


OWN_CHOICES, SPENT_MAX = 12, 256
CHECK_PERIOD_S = 3.0
"""Period of the search for a frontier to explore, while the robot searches for its place."""
ROAMING_SOC = 0.5
"""A lost robot that stands on a charger charges up to this state of charge (chosen), and then moves on."""
SIGHT_M = 1.5
"""Greatest distance from which a frontier is observed."""
HERE_M = 0.3
"""A robot this near to a place counts as there."""
EVERYWHERE_M = 1e6
"""Robots within this distance are considered: all of the team."""
DECIDE_PERIOD_S = 1.0
"""Period in which a robot that explores by its own choice decides again, as a coordinator does by `revise_s`."""


class ExploreBehavior(Behavior):
    """Explores one frontier after the other."""

    kind = EXPLORE
    task_parameters = TaskParameters

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When a frontier counts as explored."""

        seen_radius_m: float = 0.5
        """A goal is reached when no frontier remains within this distance of it."""
        alone_s: float = 3.0
        """After this time without a message from a coordinator the robot chooses frontiers itself."""
        exploration: Name = JOINT
        """Name of the exploration strategy by which it does so, as in `[planning]`; the same for all robots. Not
        `auto`: `tours` would be compiled during the run, which stops a live robot for seconds. `none`: it chooses none.
        """

        reserve_share: Share = 0.1
        """Share of the battery that remains unused on the path to a self-chosen frontier and on to a charger."""

        def __post_init__(self) -> None:
            super().__post_init__()
            if self.exploration != NO_EXPLORATION:
                STRATEGIES.check(self.exploration)

    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._travel = Travel(self.env, self.parameters)
        self._task: Task | None = None
        self._is_own = False
        """The robot has chosen the task itself."""
        self._chooses = self.parameters.exploration != NO_EXPLORATION
        self._own_choices = 0
        self._is_hidden = False
        """No place from which the robot could see its frontier is known."""
        self._least_cells = MIN_CELLS
        """A goal with only shorter frontiers around it counts as seen."""
        self._frame = ARENA
        """The map frame of the robot's own choice."""
        self._spent: deque[Point2D] = deque(maxlen=SPENT_MAX)
        """Self-chosen frontiers, in the robot's own frame, that remained after a visit."""
        strategy = strategy_of(self.parameters.exploration, self._record_strategy)
        self._team = TeamChoice(self.env.robot, self.env.board, strategy, self.parameters.reserve_share)
        self._decide_due_ns = 0

    def activate(self) -> None:
        self._travel.connect()
        self.env.do_tasks(self._accept, self._let_go)
        self.env.board.behavior = IDLE
        self._started_ns = self._check_due_ns = self.env.clock.now_ns()

    def deactivate(self) -> None:
        self._let_go("deactivated")

    def emergency_halt(self) -> None:
        self._task, self._is_own = None, False
        self.env.tasks.vacate(self.env.plugin)
        self._travel.forget()
        self.env.board.behavior = HALTED

    @external
    def goal(self) -> Point2D | None:
        """The frontier that the robot drives to; null if none."""
        return None if self._task is None else self._task.place

    def step(self) -> None:
        tasks, own = self.env.tasks, self.env.plugin
        if self._is_own and not tasks.occupies(own):  # a task has come, or another behavior: the wheels are its own
            self._task, self._is_own = None, False
            self._travel.forget()
        if self._is_own and self._frame != self.env.board.frame:  # the chosen place is in another frame
            self._finish(TaskState.FAILED, "the robot maps in another frame now")
            self._spent.clear()
        may_choose = self._chooses and (self._may_roam() if self._travel.lost else self._is_alone())
        if self._task is None and may_choose and self._is_free() and tasks.occupy(own):
            self._travel.roams, self._frame = bool(self._travel.lost), self.env.board.frame
            self._choose()
        elif self._is_own and may_choose and not self._travel.roams and not self._travel.lost:
            self._revise()
        if self._task is not None:
            self._pursue(self._task)
        elif self.env.board.behavior == IDLE:
            self._travel.make_room()
        else:
            self._travel.forget()  # another behavior drives

    def _pursue(self, task: Task) -> None:
        if self.env.board.map_paused and not self._travel.lost:  # nothing that it sees would be mapped
            self._finish(TaskState.FAILED, self.env.board.map_paused)
            return
        if (self._travel.roams or not self._travel.lost) and self._is_seen(self._travel.view(), task.place):
            self._finish(TaskState.DONE, "nothing unknown is left there")
            return
        if self._is_hidden:
            self._finish(TaskState.DONE, "walls hide it from wherever the robot can stand")
            return
        progress = self._travel.step()
        if progress is TravelState.TOO_NARROW:
            words, result = too_narrow(self._travel)
            self._finish(TaskState.FAILED, words, result)
        elif progress is TravelState.ARRIVED:
            self._finish(TaskState.DONE, "arrived")
        elif progress in TROUBLE:
            self._finish(TaskState.FAILED, TROUBLE[progress])

    def _aim(self, goal: Point2D, priority: float = 0.0) -> bool:
        """Set out to a place from which a frontier can be seen; False if there is no path.

        The nearest place to stand may not do: a wall may hide the frontier from there, such as the inside of a shelf.
        """
        place = self._travel.standpoint(goal, SIGHT_M)
        is_narrow = place is None
        if place is None or self._travel.pose().distance_m(place) < HERE_M:  # it is there and has not seen it
            nearer = self._travel.narrow_standpoint(goal, SIGHT_M)
            if nearer is not None and (place is None or nearer.distance_m(goal) < place.distance_m(goal)):
                place, is_narrow = nearer, True
        if place is None:
            self._is_hidden = self._travel.plan(goal) is not None
            return self._is_hidden
        if self._travel.set_out(place, goal, priority=priority, is_narrow=is_narrow):
            self._is_hidden = False
            return True
        return False

    def _is_seen(self, view: MapCells, goal: Point2D) -> bool:
        return self._longest_frontier(view, goal) < self._least_cells

    def _search_for(self, goal: Point2D) -> None:
        """Record the length below which a frontier is left: one that is short from the start may be a passage."""
        view, self._least_cells = self._travel.view(), 1
        cells = self._longest_frontier(view, goal)
        shortest = mapped_gap_cells(self._travel.driver.radius_m(), view.geometry.resolution_m)
        self._least_cells = cells if shortest <= cells < MIN_CELLS else MIN_CELLS

    def _longest_frontier(self, view: MapCells, goal: Point2D) -> int:
        """Number of cells of the longest frontier around a goal; 0 if it is surely below `_least_cells`."""
        geometry = view.geometry
        row, column = geometry.cell_of(goal.x_m, goal.y_m)
        reach = round(self.parameters.seen_radius_m / geometry.resolution_m)
        # One cell more around, because whether a cell is a frontier depends on its neighbours.
        rows = slice(max(row - reach - 1, 0), row + reach + 2)
        columns = slice(max(column - reach - 1, 0), column + reach + 2)
        left = frontier_mask(view.classes[rows, columns])[1:-1, 1:-1]
        if np.count_nonzero(left) < self._least_cells:
            return 0
        labels, groups = touching(left, corners=True)
        return 0 if groups == 0 else int(np.bincount(labels.ravel())[1:].max())

    def _is_alone(self) -> bool:
        received_ns = self.env.tasks.coordinator_seen_ns
        since_ns = self.env.clock.now_ns() - (self._started_ns if received_ns is None else received_ns)
        return since_ns > to_ns(self.parameters.alone_s)

    def _may_roam(self) -> bool:
        """Whether the lost robot maps in its own frame: with more observations it is localised sooner."""
        battery = self.env.board.battery
        return self.env.board.frame != ARENA and (battery is None or not battery.charging or battery.soc >= ROAMING_SOC)

    def _is_free(self) -> bool:
        """Whether no behavior drives, or the robot searches for its place although it could explore."""
        behavior, now_ns = self.env.board.behavior, self.env.clock.now_ns()
        if behavior != FIND_ITSELF or now_ns < self._check_due_ns:
            return behavior == IDLE
        self._check_due_ns = now_ns + to_ns(CHECK_PERIOD_S)
        places = (self._travel.standpoint(goal, SIGHT_M) for goal in self._frontiers() if goal not in self._spent)
        return any(place is not None and self._travel.plan(place) is not None for place in places)

    def _frontiers(self) -> list[Point2D]:
        """The nearest frontiers, the nearest first."""
        view, pose = self._travel.view(), self._travel.pose()
        frontiers = [view.geometry.center_of(found.row, found.column) for found in find_frontiers(view.classes)]
        return sorted(frontiers, key=pose.distance_m)[:OWN_CHOICES]

    def _choose(self) -> None:
        """Set out to a self-chosen frontier, if there is one."""
        if not self._travel.roams:
            self._revise()
        else:
            for goal in self._frontiers():
                if goal not in self._spent and self._set_out(goal):
                    break
        if self._task is None:
            self.env.tasks.vacate(self.env.plugin)

    def _revise(self) -> None:
        """Choose a goal with regard to the other robots; the present goal may stay."""
        now_ns, travel = self.env.clock.now_ns(), self._travel
        if now_ns < self._decide_due_ns:
            return
        self._decide_due_ns = now_ns + to_ns(DECIDE_PERIOD_S)
        place, own = travel.place(), None if self._task is None else self._task.place
        teammates = travel.teammates.nearby(place, EVERYWHERE_M)
        if own is not None and not teammates:
            return  # no other robot can explore its goal first
        goal = self._team.choose_own(place, travel.driver.radius_m(), own, teammates, now_ns)
        if goal is not None and not self._set_out(goal):
            self._team.record_failure(self.env.robot, goal, now_ns)
            self._decide_due_ns = now_ns

    def _set_out(self, goal: Point2D) -> bool:
        if not self._aim(goal):
            return False
        self._search_for(goal)
        self._own_choices += 1
        self._task = Task(id=f"own-{self.env.robot}-{self._own_choices}", kind=EXPLORE, place=goal)
        self._is_own = True
        self.env.board.behavior = ALONE
        return True

    def _record_own(self, goal: Point2D, state: TaskState, result: dict[str, float] | None) -> None:
        """Record the result for a self-chosen frontier."""
        now_ns = self._decide_due_ns = self.env.clock.now_ns()
        if self._travel.roams:
            self._spent.append(goal)
        elif state is TaskState.DONE:
            self._team.record_visit(goal)
        else:
            self._team.record_failure(self.env.robot, goal, now_ns)
            self._team.record_gap(self._travel.place(), (result or {}).get(GAP), now_ns)

    def _record_strategy(self, name: str, reason: str) -> None:
        self.env.wire.refusals.record_failure("exploration_strategy", name, reason)

    def _accept(self, task: Task) -> TaskAnswer:
        unsure = self.env.board.map_paused and PositionLost(self.env.robot, self.env.board.map_paused)
        if lost := self._travel.position_lost or unsure:
            return TaskAnswer.refused(lost)
        self._travel.roams = False
        if not self._aim(task.place, task.priority):
            return TaskAnswer.refused(no_path())
        self._search_for(task.place)
        self._task, self._is_own = task, False
        self.env.board.behavior = "explore"
        return TaskAnswer(accepted=True)

    def _let_go(self, _reason: str) -> None:
        self._task, self._is_own = None, False
        self._travel.stop()
        self.env.board.behavior = IDLE

    def _finish(self, state: TaskState, reason: str, result: dict[str, float] | None = None) -> None:
        task, self._task = self._task, None
        if self._is_own:
            self._is_own = False
            self.env.tasks.vacate(self.env.plugin)
            if task is not None:
                self._record_own(task.place, state, result)
        if state is TaskState.FAILED:
            self._travel.stop()
        else:
            self._travel.coast()
        if task is not None:
            self.env.tasks.end(task.id, state, reason, result)
        self.env.board.behavior = IDLE
