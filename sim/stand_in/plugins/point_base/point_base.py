"""Point base: drives the body of a stand-in robot, and tells the board of it."""

import msgspec

from robrain.agent.plugin import Unit
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.stand_in.plugins.point_base.interface import PointBaseInterface
from robrain.sim.stand_in.point_body import CAPACITY_J, STANDING_MODEL, PointBody

PERIOD_S = 0.1
RADIUS_M = 0.2


class PointBase(Unit):
    """Moves the point. Without a body, which `attach` gives it, it does nothing."""

    interface = PointBaseInterface
    period_s = PERIOD_S

    def init(self) -> None:
        self._body: PointBody | None = None

    def attach(self, body: PointBody) -> None:
        """Drive this body."""
        self._body = body
        board = self.env.board
        board.radius_m = RADIUS_M
        board.T_arena_odom = Pose2D(body.start.x_m, body.start.y_m, 0.0)
        self.step()

    def step(self) -> None:
        body, board = self._body, self.env.board
        if body is None:
            return
        board.pose = body.pose()
        board.velocity = body.velocity()
        board.battery = battery = body.battery()
        board.energy = msgspec.structs.replace(STANDING_MODEL, usable_j=battery.remaining_low_j)

    def go(self, goal: Point2D, task_id: str) -> None:
        """See PointBaseInterface."""
        self._command(goal, task_id)

    def stay(self, task_id: str) -> None:
        """See PointBaseInterface."""
        self._command(None, task_id)

    def stand(self) -> None:
        """See PointBaseInterface."""
        self._command(None, "")

    def place(self) -> Point2D:
        """See PointBaseInterface."""
        return Point2D(0.0, 0.0) if self._body is None else self._body.place

    def nearest_charger(self) -> Point2D | None:
        """See PointBaseInterface."""
        return None if self._body is None else self._body.nearest_charger

    def energy_j(self) -> float:
        """See PointBaseInterface."""
        return 0.0 if self._body is None else self._body.energy_j

    def soc(self) -> float:
        """See PointBaseInterface."""
        return self.energy_j() / CAPACITY_J

    def emergency_halt(self) -> None:
        self._command(None, "")

    def _command(self, goal: Point2D | None, task_id: str) -> None:
        if self._body is None:
            return
        status = self.env.tasks.status if task_id else None
        is_at_it = status is not None and status.id == task_id
        work = (task_id, status.epoch) if is_at_it and status is not None else None
        self._body.command(goal, work)
