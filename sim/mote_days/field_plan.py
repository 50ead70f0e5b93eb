"""How a mote field is run: its routes, its duties, and the robots that collect."""

from enum import StrEnum

import msgspec

from robrain.algorithms.motes.mote_energy import MoteEnergy, mica2
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import check_not_negative, check_positive, check_within


class Routing(StrEnum):
    """How readings travel between motes."""

    TREE = "tree"
    """A collection tree with the fewest hops."""
    LIFETIME = "lifetime"
    """Routes in turn that spare the motes with little energy."""
    NONE = "none"
    """Not at all: robots collect everything."""


class MoteSite(msgspec.Struct, frozen=True, kw_only=True):
    """Where motes lie, and what they are."""

    places: tuple[Point2D, ...]
    sink: Point2D
    """Where readings leave the field, and where the robots' charger is."""
    size_m: float
    """The floor is a square from the origin of this width."""
    range_m: float = 22.0
    """Distance up to which two motes hear each other."""
    sensing_m: float = 15.0
    """A mote tells of the floor up to this distance; chosen."""
    period_s: float = 60.0
    """Time between two readings of a mote."""
    energy: MoteEnergy = mica2()
    log_readings: int = 30_000
    """What a mote stores; of more, the oldest are lost."""

    def __post_init__(self) -> None:
        check_positive(self, "size_m", "range_m", "sensing_m", "period_s")
        check_within(self, 1, 1_000_000, "log_readings")


class RobotFigures(msgspec.Struct, frozen=True, kw_only=True):
    """A robot that collects."""

    speed_m_s: float = 0.5
    standing_w: float = 8.0
    """All the time on a tour, for computer, sensors and radio: that of the simulated robots."""
    driving_j_per_m: float = 20.0
    """What driving takes besides; about that of the simulated robots."""
    reach_m: float = 15.0
    """Distance up to which it collects, which leaves a margin to the radio's range."""
    readings_per_s: float = 25.0
    """How fast a mote hands over what it has stored: one every 40 ms."""

    def __post_init__(self) -> None:
        check_positive(self, "speed_m_s", "standing_w", "driving_j_per_m", "reach_m", "readings_per_s")


class FieldPlan(msgspec.Struct, frozen=True, kw_only=True):
    """How the field is run. Raises ValueError if a value makes no sense."""

    routing: Routing = Routing.LIFETIME
    tours_per_day: float = 0.0
    """How often a robot visits all motes; 0 for never."""
    goal_days: float = 0.0
    """With tours: the lifetime that is aimed at. Readings travel over the air as far as it allows."""
    takes_turns: bool = False
    """Whether only as many motes are on duty as the coverage needs, in turn."""
    relays: int = 0
    """Number of robots that may stand in the field all the time, to connect parts that do not reach the sink."""
    replan_days: float = 10.0
    """Time after which routes and duties are made again; also after each death."""
    robot: RobotFigures = RobotFigures()

    def __post_init__(self) -> None:
        check_not_negative(self, "tours_per_day", "goal_days", finite=True)
        check_positive(self, "replan_days")
        check_within(self, 0, 1000, "relays")
        if self.routing is Routing.NONE and self.tours_per_day == 0:
            raise ValueError("expected tours_per_day above 0 if readings do not travel over the air")
