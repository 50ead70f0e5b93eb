"""A behavior for tests: goes where it is told, and makes room while it has nowhere to go."""

from robrain.agent.plugin import Behavior, external
from robrain.plugins.behavior.travel import Travel, TravelParameters, TravelState
from robrain.protocol.model.geometry import Point2D


class Courier(Behavior):
    """Drives to places."""

    Parameters = TravelParameters
    period_s = 0.2

    def init(self) -> None:
        self.travel = Travel(self.env, self.parameters)
        self.progress = TravelState.ARRIVED

    def activate(self) -> None:
        self.travel.connect()

    def emergency_halt(self) -> None:
        self.travel.forget()

    @external
    def go(self, x_m: float, y_m: float, priority: int = 0) -> bool:
        """Set out; false if there is no way."""
        self.progress = TravelState.MOVING
        return self.travel.set_out(Point2D(x_m, y_m), priority=priority)

    def step(self) -> None:
        if self.progress in (TravelState.MOVING, TravelState.WAITING):
            self.progress = self.travel.step()
            if self.progress not in (TravelState.MOVING, TravelState.WAITING):
                self.travel.stop()
        else:
            self.travel.make_room()
