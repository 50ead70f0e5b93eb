"""Idle: behavior of a robot without a task.

The robot stands, or returns to its parking place after a while.

A robot that does not know its place searches for it first.
"""

import math
from typing import Annotated

from msgspec import Meta

from robrain.agent.plugin import Behavior, external
from robrain.plugins.behavior.travel import FIND_ITSELF, Travel, TravelParameters, TravelState
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import NotNegative

NEAR_M = 0.5
"""A robot within this distance of its place stays there."""
SEARCH_AFTER_S = 3.0
"""Another behavior may have a better method to localise the robot: it has this time to begin."""
HOME_PRIORITY = -1.0
"""Of the path home: tasks go first."""
RETRY_S = 30.0
"""Time between a path home that ended early and the next try."""


class IdleBehavior(Behavior):
    """Stands, or returns to its home if it has one."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """Where to wait, and when to go there."""

        home: Annotated[tuple[float, ...], Meta(max_length=2)] = ()
        """x and y in metres, arena frame; empty if the robot stays where it is."""
        return_after_s: NotNegative = 10.0

        def __post_init__(self) -> None:
            super().__post_init__()
            if len(self.home) == 1:
                raise ValueError(f"expected home to be empty or x and y, got {self.home}")

    period_s: float | None = 1.0
    parameters: Parameters

    def init(self) -> None:
        self._travel = Travel(self.env, self.parameters)
        self._home = Point2D(*self.parameters.home) if self.parameters.home else None
        self._is_going = False
        self._is_searching = self._has_searched = False
        self._since_ns: int | None = None
        self._lost_ns: int | None = None
        """Time since which the idle robot has been lost."""

    def activate(self) -> None:
        self._travel.connect()

    def deactivate(self) -> None:
        self._end()

    def emergency_halt(self) -> None:
        self._is_going = self._is_searching = False
        self._since_ns = None
        self._travel.forget()

    @external
    def wait_at(self, x_m: float, y_m: float) -> None:
        """Set the place where the idle robot waits, arena frame."""
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected a finite place, got {x_m}, {y_m}")
        self._home = Point2D(x_m, y_m)

    @external
    def idle_s(self) -> float:
        """Idle time, without the path home; 0 while the robot has a task."""
        return 0.0 if self._since_ns is None else to_seconds(self.env.clock.now_ns() - self._since_ns)

    def step(self) -> None:
        if self._travel.lost or self._is_searching:
            self._find_itself()
        if self._travel.lost:
            return
        self._lost_ns = None
        if self._is_going:
            self._go()
            return
        now_ns = self.env.clock.now_ns()
        if self.env.board.behavior not in ("idle", ""):
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns
        elif self._home is not None and now_ns - self._since_ns >= to_ns(self.parameters.return_after_s):
            self._set_out(self._home, now_ns)

    def _find_itself(self) -> None:
        """Search for the place of a lost, idle robot; once, and not while it is being charged."""
        board, tasks, own = self.env.board, self.env.tasks, self.env.plugin
        is_charging = board.battery is not None and board.battery.charging
        is_found = not self._travel.lost
        self._has_searched = self._has_searched and not is_found
        if self._is_searching and not tasks.occupies(own):
            self._is_searching = False
            self._travel.forget()
        elif self._is_searching and (is_found or is_charging or not self._travel.find_itself()):
            self._is_searching = False
            self._has_searched = not is_found and not is_charging
            self._travel.stop()
            board.behavior = "idle"
            tasks.vacate(own)
        elif not self._is_searching and not (is_found or is_charging or self._has_searched):
            has_nothing_to_do = self._is_going or board.behavior in ("idle", "")
            now_ns = self.env.clock.now_ns()
            if not has_nothing_to_do or self._lost_ns is None:
                self._lost_ns = now_ns
            # A robot that maps in its own frame may explore instead, as soon as it sees a frontier.
            firm = self._travel.lost if board.frame == ARENA else ""
            is_due = has_nothing_to_do and now_ns - self._lost_ns >= to_ns(SEARCH_AFTER_S)
            if is_due and tasks.occupy(own, firm=firm):
                self._is_going, self._is_searching = False, True
                board.behavior = FIND_ITSELF
                self._travel.find_itself()

    def _set_out(self, home: Point2D, now_ns: int) -> None:
        if self._travel.pose().distance_m(home) < NEAR_M or not self._travel.may_stay(home):
            return
        self._since_ns = now_ns + to_ns(RETRY_S)
        if not self.env.tasks.occupy(self.env.plugin):
            return
        if self._travel.set_out(home, priority=HOME_PRIORITY):
            self._is_going = True
            self.env.board.behavior = "return"
        else:
            self.env.tasks.vacate(self.env.plugin)

    def _go(self) -> None:
        if not self.env.tasks.occupies(self.env.plugin):  # something to do has come: the wheels are its own
            self._is_going = False
            self._since_ns = None
            self._travel.forget()
        elif self._travel.step() not in (TravelState.MOVING, TravelState.WAITING):
            self._end()

    def _end(self) -> None:
        if (self._is_going or self._is_searching) and self.env.tasks.occupies(self.env.plugin):
            self._travel.stop()
            self.env.board.behavior = "idle"
        self._is_going = self._is_searching = False
        self.env.tasks.vacate(self.env.plugin)
