"""What the base of a stand-in robot offers."""

from typing import Protocol

from robrain.protocol.model.geometry import Point2D


class PointBaseInterface(Protocol):
    """Moves the point; commands are to be repeated, at least every 0.5 s."""

    def go(self, goal: Point2D, task_id: str) -> None:
        """Drive towards a goal, for a task; empty if for none."""

    def stay(self, task_id: str) -> None:
        """Stand, for a task; empty if for none."""

    def stand(self) -> None:
        """Stand, for no task."""

    def place(self) -> Point2D:
        """Where the robot is, arena frame."""

    def nearest_charger(self) -> Point2D | None:
        """The nearest charger; None if there is none."""

    def energy_j(self) -> float:
        """What the battery still gives."""

    def soc(self) -> float:
        """State of charge, 0 to 1."""
