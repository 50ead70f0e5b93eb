"""A driver on fake devices, without host, Zenoh or arena; records its commands step by step."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from robrain.agent.event import Event, Mailbox
from robrain.plugins.device.mocdevice.interface import Counters
from robrain.plugins.device.range_sensors import Bump, RangeRing
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.unit.driver.driver import PERIOD_S, Driver
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionProgress
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

RADIUS_M = 0.2
RAYS = 360


class Wheels:
    """A motor controller that obeys at once and can be silenced."""

    def __init__(self) -> None:
        self.at = Pose2D(0.0, 0.0, 0.0)
        self.fresh = True
        self.steers = False
        """Whether the base cannot drive sideways."""
        self.radius_min_m = 0.0
        self.until_ns = 0
        self.twist = Twist2D()
        self.said: list[Twist2D | str] = []
        """All commands; a stop is the text `stop`."""

    def drive(self, twist: Twist2D) -> None:
        self.twist = twist
        self.said.append(twist)

    def stop(self) -> None:
        self.twist = Twist2D()
        self.said.append("stop")

    def is_fresh(self) -> bool:
        return self.fresh

    def pose(self) -> Pose2D:
        return self.at

    def pose_if_fresh(self) -> tuple[Pose2D, bool]:
        return self.at, self.fresh

    def pose_at(self, stamp_ns: int) -> Pose2D:
        return self.at

    def odometry_until_ns(self) -> int:
        return self.until_ns

    def velocity(self) -> Twist2D:
        return self.twist

    def radius_m(self) -> float:
        return RADIUS_M

    def is_holonomic(self) -> bool:
        return not self.steers

    def turn_radius_min_m(self) -> float:
        return self.radius_min_m

    def counters(self) -> Counters:
        return Counters(1, 2, 3, 4, 5)

    def status(self) -> None:
        return None

    def move(self, seconds: float) -> None:
        """Move on with the last command."""
        self.at = self.at.compose(
            Pose2D(self.twist.forward_m_s * seconds, self.twist.left_m_s * seconds, self.twist.yaw_rad_s * seconds)
        )


class Lidar:
    """A lidar that sees one wall at x = `wall_m` of odom, or nothing; without `speaks` it repeats its last scan."""

    def __init__(self, wheels: Wheels, clock: VirtualClock) -> None:
        self.wall_m = math.inf
        self.speaks = True
        self.doubts: list[str] = []
        self._wheels, self._clock = wheels, clock
        self._last: LaserScan | None = None

    def latest(self) -> LaserScan | None:
        if self.speaks:
            at = self._wheels.at
            angles_rad = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
            with np.errstate(divide="ignore"):
                ranges_m = (self.wall_m - at.x_m) / np.cos(angles_rad + at.yaw_rad)
            ranges_m[~((ranges_m >= 0.0) & (ranges_m < 6.0))] = 6.0
            self._last = LaserScan(self._clock.now_ns(), tuple(angles_rad.tolist()), tuple(ranges_m.tolist()), 6.0)
        return self._last

    def doubt(self, why: str) -> None:
        self.doubts.append(why)


class Ring:
    """Range sensors without echoes, and bump contacts."""

    def __init__(self) -> None:
        self.measured = Event[RangeRing]()
        self.bumped = Event[Bump]()
        self.pressed: tuple[float, ...] = ()

    def latest(self) -> RangeRing | None:
        return None

    def pressed_rad(self) -> tuple[float, ...]:
        return self.pressed


class BareDriver:
    """The driver, its devices, and its recorded events."""

    def __init__(self, **parameters: Any) -> None:
        self.clock = VirtualClock()
        self.wheels = Wheels()
        self.lidar = Lidar(self.wheels, self.clock)
        self.ring = Ring()
        self.hurries = 0
        self.ends: list[ActionEnd] = []
        self.shares: list[ActionProgress] = []
        self.arrivals: list[Point2D] = []
        self._mailbox = Mailbox()
        self._at_end: list[Callable[[str], None]] = []
        self.plugin = Driver(self, Driver.Parameters(**parameters))
        self.plugin.init()
        for event, told in (
            (self.plugin.finished, self.ends),
            (self.plugin.progress, self.shares),
            (self.plugin.arrived, self.arrivals),
        ):
            event.add(told.append, self._mailbox)

    # -- what the driver asks its environment for -----------------------------------------------------------

    def use(self, name: str, _interface: type) -> Any:
        return {"mocdevice": self.wheels, "scan": self.lidar, "range_sensors": self.ring}[name]

    def observe(self, event: Event[Any], function: Callable[[Any], None]) -> None:
        event.add(function, self._mailbox)

    @property
    def caller(self) -> str:
        return "explore"

    def hurry(self) -> None:
        self.hurries += 1

    def at_end(self, function: Callable[[str], None]) -> None:
        self._at_end.append(function)

    # -- what the test does ---------------------------------------------------------------------------------

    def end_actions(self, why: str) -> None:
        """End an action, as the host does on a halt or when deactivating the plugin."""
        for function in self._at_end:
            function(why)

    def hand(self, forward_m_s: float, left_m_s: float, yaw_rad_s: float) -> None:
        """Drive by hand under a new lease."""
        by_hand(self.plugin, forward_m_s, left_m_s, yaw_rad_s)

    def step(self, count: int = 1, each: Callable[[], None] | None = None) -> None:
        """Have the driver step for so many periods; the robot obeys in between."""
        for _ in range(count):
            until_ns = self.clock.now_ns() + to_ns(PERIOD_S)
            while (left_ns := until_ns - self.clock.now_ns()) > 0:
                passes_ns = min(left_ns, to_ns(self.plugin.period_s))
                self.clock.advance_to(self.clock.now_ns() + passes_ns)
                self.wheels.move(passes_ns * 1e-9)
                self._mailbox.deliver()
                if each is not None:
                    each()
                self.plugin.step()
        self._mailbox.deliver()

    def wait(self, seconds: float) -> None:
        """Let time pass without a step."""
        self.clock.advance_to(self.clock.now_ns() + to_ns(seconds))

    def bump(self, *directions_rad: float) -> None:
        """Change the contacts and notify the driver."""
        self.ring.bumped.notify(Bump(self.clock.now_ns(), directions_rad))
        self._mailbox.deliver()

    def commands(self) -> list[Twist2D | str]:
        """Commands since the last call."""
        said, self.wheels.said = self.wheels.said, []
        return said


def by_hand(driver: Driver, forward_m_s: float, left_m_s: float, yaw_rad_s: float) -> None:
    """Drive by hand under a new lease."""
    driver.move(forward_m_s, left_m_s, yaw_rad_s, driver.acquire_hand_lease("ann").lease)
