"""Courier: a behavior that goes from place to place without a coordinator."""

from typing import Annotated

from msgspec import Meta

from robrain.agent.plugin import Behavior, external
from robrain.plugins.behavior.travel import Travel, TravelParameters, TravelState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Metres

UNDER_WAY = (TravelState.MOVING, TravelState.WAITING)


class Courier(Behavior):
    """Goes to its places in turn, or where it is told; makes room while it is bound for nowhere."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """Where to go."""

        places: Annotated[tuple[tuple[Metres, Metres], ...], Meta(max_length=1000)] = ()
        """x and y, arena frame; the robot begins with the first again after the last."""

    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self.travel = Travel(self.env, self.parameters)
        self.state = TravelState.ARRIVED
        self.trips = 0
        """Number of places reached."""

    def activate(self) -> None:
        self.travel.connect()

    def emergency_halt(self) -> None:
        self.travel.forget()

    @external
    def go(self, x_m: Metres, y_m: Metres, priority: float = 0.0) -> bool:
        """Set out; false if there is no path."""
        sets_out = self.travel.set_out(Point2D(x_m, y_m), priority=priority)
        self.state = TravelState.MOVING if sets_out else TravelState.NO_PATH
        return sets_out

    def step(self) -> None:
        if self.state in UNDER_WAY:
            self.state = self.travel.step()
            if self.state in UNDER_WAY:
                return
            self.trips += self.state is TravelState.ARRIVED
            self.travel.stop()
        places = self.parameters.places
        if not places or not self.go(*places[self.trips % len(places)]):
            self.travel.make_room()
