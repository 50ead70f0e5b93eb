import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.clock import LiveClock, VirtualClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import RobotTruth
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.battery import BatterySpec, GaugeSpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.world.arena import Arena
from robrain.sim.world.world import World
from tests.waiting import PATIENCE_S, until

RESOLUTION_M = 0.05
TICK_NS = 20_000_000
CAN_SENDER_BYTES = 8
BASE = OmniBase()
SIGNALS = ("wheel_1_rad_s", "wheel_2_rad_s", "wheel_3_rad_s")


def room(width_m: float = 4.0, height_m: float = 4.0) -> FloorPlan:
    """A room with walls 0.1 m thick; its inside runs from 0.1 m to the size less 0.1 m."""
    occupied = np.ones((round(height_m / RESOLUTION_M), round(width_m / RESOLUTION_M)), np.bool_)
    occupied[2:-2, 2:-2] = False
    return FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "room")


def crossed_room() -> FloorPlan:
    """A room with a cross of walls one cell thin."""
    occupied = room().occupied.copy()
    occupied[40, 10:70] = True
    occupied[10:70, 40] = True
    return FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "crossed room")


class Stage:
    """An arena in lockstep, with a host on each robot's bus."""

    def __init__(
        self,
        *starts: Pose2D,
        plan: FloorPlan | None = None,
        motes: tuple[ArenaMote, ...] = (),
        seed: int = 1,
        battery: BatterySpec = BatterySpec(),  # noqa: B008 - frozen
        noise_m: float = 0.01,
    ) -> None:
        self.session = open_lockstep_session()
        self.clock = VirtualClock()
        self.endpoint = Endpoint(self.session, "test", self.clock, Drive.LOCKSTEP)
        self.traffic = Inbox(1_000_000, every=True)
        for topic in (
            arena_messages.ARENA_CAN,
            arena_messages.ARENA_SCAN,
            arena_messages.ARENA_RADIO_RX,
            arena_messages.ARENA_CLOCK,
            arena_messages.ARENA_TRUTH,
        ):
            self.endpoint.subscribe(self.traffic, topic)
        lidar = LidarSpec(noise_m=noise_m)
        robots = [
            ArenaRobot(name=f"r{number}", start=start, battery=battery, lidar=lidar)
            for number, start in enumerate(starts, 1)
        ]
        self.hosts = {
            robot.name: ZenohBus(f"{robot.name}/can0", session=self.session, team="test", direct=True)
            for robot in robots
        }
        rng = np.random.default_rng(seed)
        self.arena = Arena(World(plan if plan is not None else room(), robots, motes, seed), self.endpoint, rng=rng)
        self.ticks = 0

    def command(self, robot: str, *wheels_rad_s: float) -> None:
        values = dict(zip(SIGNALS, wheels_rad_s, strict=True))
        self.hosts[robot].send(codec("WheelCommand").pack(self.ticks, **values))

    def run(self, ticks: int, **twists: Twist2D) -> None:
        """Ticks with the robots commanded to these velocities, every 100 ms."""
        for tick in range(ticks):
            if tick % 5 == 0:
                for robot, twist in twists.items():
                    self.command(robot, *BASE.wheel_speeds_rad_s(twist))
            self.ticks += 1
            self.clock.advance_to(self.ticks * TICK_NS)
            self.arena.step()

    def truth(self, robot: str = "r1") -> RobotTruth:
        return next(truth for truth in self.arena.truth.robots if truth.robot == robot)

    def frames(self, name: str, robot: str = "r1") -> list[dict[str, float]]:
        frames = iter(lambda: self.hosts[robot].recv(timeout=0), None)
        return [codec(name).unpack(frame) for frame in frames if frame.arbitration_id == codec(name).arbitration_id]

    def messages(self, name: str) -> list:
        return [received.message for received in self.traffic.drain() if received.topic.name == name]

    def close(self) -> None:
        self.arena.close()
        for host in self.hosts.values():
            host.shutdown()
        self.endpoint.close()
        self.session.close()


@pytest.fixture
def stage() -> Iterator:
    opened = []

    def build(*starts: Pose2D, **options) -> Stage:
        opened.append(Stage(*starts, **options))
        return opened[-1]

    yield build
    for one in opened:
        one.close()


def turns_rad(counts: list[dict[str, float]]) -> tuple[float, float, float]:
    """How far each wheel turned between the first and the last of these encoder frames."""
    turns = [0.0, 0.0, 0.0]
    for before, after in itertools.pairwise(counts):
        for wheel in range(3):
            name = f"wheel_{wheel + 1}_ticks"
            moved = (int(after[name]) - int(before[name]) + 32768) % 65536 - 32768
            turns[wheel] += moved * BASE.rad_per_tick
    return turns[0], turns[1], turns[2]


def test_encoders_alone_lead_along_the_true_way(stage):
    pose = start = Pose2D(2.0, 1.0, 0.4)
    one = stage(start)
    one.run(1)
    for twist in (Twist2D(0.3, 0.1, 1.5), Twist2D(0.4, 0.0, -1.0), Twist2D(-0.2, 0.2, 2.0)):
        one.run(80, r1=twist)
    for pair in itertools.pairwise(one.frames("WheelEncoders")):
        moved = BASE.twist(*turns_rad(list(pair)))
        halfway = Pose2D(0.0, 0.0, moved.yaw_rad_s / 2)
        pose = pose.compose(halfway).compose(Pose2D(moved.forward_m_s, moved.left_m_s, 0.0)).compose(halfway)
    assert one.truth().collisions == 0
    assert pose.distance_m(one.truth().pose) < 2e-3
    assert abs(pose.yaw_rad - one.truth().pose.yaw_rad) < 2e-3


def test_running_into_a_wall_is_one_collision_however_long_it_pushes(stage):
    one = stage(Pose2D(3.0, 2.0, 0.0))
    one.run(400, r1=Twist2D(0.5))
    assert one.truth().collisions == 1
    assert one.truth().pose.x_m == pytest.approx(3.7, abs=0.01)
    one.run(100, r1=Twist2D(-0.5))
    one.run(150, r1=Twist2D(0.5))
    assert one.truth().collisions == 2


def test_sliding_along_a_wall_of_many_shapes_is_one_collision(stage):
    occupied = room(8.0, 4.0).occupied.copy()
    occupied[:, 60:] = np.roll(occupied[:, 60:], 1, axis=0)  # a step of one cell, so that no shape goes all the way
    one = stage(Pose2D(4.0, 0.5, math.pi), plan=FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "hall"))
    one.run(300, r1=Twist2D(0.4, 0.2))
    assert one.truth().pose.x_m < 2.5
    assert one.truth().collisions == 1


def test_encoders_stand_still_while_a_wall_holds_the_robot(stage):
    one = stage(Pose2D(3.0, 2.0, 0.0))
    one.run(200, r1=Twist2D(0.5))
    one.frames("WheelEncoders")
    path_m = one.truth().distance_m
    one.run(100, r1=Twist2D(0.5))
    assert one.truth().distance_m - path_m < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("degrees", range(0, 360, 60))
def test_no_robot_gets_into_a_wall_at_full_speed(stage, degrees):
    plan = crossed_room()
    one = stage(Pose2D(1.05, 1.15, math.radians(degrees)), plan=plan)
    wheels = np.array(BASE.wheel_speeds_rad_s(Twist2D(1.0, 0.1 * (degrees % 90) / 30, (degrees % 120) / 30 - 1.5)))
    wheels *= 32.0 / np.abs(wheels).max()
    rows, columns = np.nonzero(plan.occupied)
    centres_m = (np.stack([columns, rows], axis=1) + 0.5) * RESOLUTION_M
    deepest_m = 0.0
    for tick in range(400):
        if tick % 5 == 0:
            one.command("r1", *wheels)
        one.run(1)
        pose = one.truth().pose
        beyond_m = np.maximum(np.abs(centres_m - (pose.x_m, pose.y_m)) - RESOLUTION_M / 2, 0.0)
        deepest_m = max(deepest_m, 0.2 - float(np.hypot(*beyond_m.T).min()))
    assert one.truth().collisions >= 1
    # At most the way of one tick at the highest speed that the frame can tell.
    assert deepest_m < 1.5 * 0.02
    assert plan.contains_free(pose.x_m, pose.y_m)


def test_a_robot_whose_battery_is_empty_stops(stage):
    gauge = GaugeSpec(current_noise_a=0.0, current_offset_a=0.0)
    one = stage(Pose2D(1.0, 2.0, 0.0), battery=BatterySpec(capacity_wh=0.01, gauge=gauge))
    one.run(200, r1=Twist2D(0.3))
    place = one.truth().pose
    one.run(100, r1=Twist2D(0.3))
    assert one.truth().pose == place
    assert 0.5 * 36.0 < one.truth().energy_j < 36.0  # the rest is bound at this load, or warmed the battery
    assert one.frames("BatteryStatus")[-1]["current_a"] == 0.0


def test_a_scan_shows_walls_and_the_other_robot_but_not_oneself(stage):
    one = stage(Pose2D(1.0, 2.0, 0.0), Pose2D(2.0, 2.0, 0.0), noise_m=0.0)
    one.run(10)
    scans = {scan.robot: scan for scan in one.messages("arena_scan")}
    ranges_mm = scans["r1"].ranges_mm
    assert len(ranges_mm) == 180
    assert ranges_mm[90] == 800  # ahead: the other's hull
    assert ranges_mm[0] == 900  # behind: the wall's inside at 0.1 m
    assert ranges_mm[135] == 1900  # left
    assert scans["r1"].angle_min_rad + 90 * scans["r1"].angle_increment_rad == pytest.approx(0.0)


def test_everything_comes_at_its_rate_and_robots_take_turns_to_scan(stage):
    one = stage(Pose2D(1.0, 2.0, 0.0), Pose2D(2.0, 2.0, 0.0))
    one.run(100)
    received = one.traffic.drain()
    count = {topic: sum(one.topic.name == topic for one in received) for topic in ("arena_clock", "arena_truth")}
    assert count == {"arena_clock": 20, "arena_truth": 10}
    stamps = {
        robot: [
            one.message.stamp_ns
            for one in received
            if one.topic is arena_messages.ARENA_SCAN and one.names["robot"] == robot
        ]
        for robot in ("r1", "r2")
    }
    assert len(stamps["r1"]) == len(stamps["r2"]) == 10
    assert not set(stamps["r1"]) & set(stamps["r2"])
    assert one.arena.sim_time_s == pytest.approx(2.0)


def recorded(stage, *, seed: int, motes: int = 2) -> list[tuple[str, bytes]]:
    """Traffic of five seconds, without the sender's number in CAN frames: it is the session's."""
    places = [Point2D(1.0 + 0.5 * number, 3.0) for number in range(motes)]
    one = stage(
        Pose2D(1.0, 2.0, 0.0),
        Pose2D(3.0, 2.0, 2.0),
        seed=seed,
        motes=tuple(ArenaMote(name=f"m{number}", number=number, place=place) for number, place in enumerate(places)),
    )
    one.run(250, r1=Twist2D(0.4, 0.1, 0.3), r2=Twist2D(0.4, 0.0, -0.5))
    return [
        (key, payload[CAN_SENDER_BYTES:] if topic is arena_messages.ARENA_CAN else payload)
        for topic, key, payload in one.traffic.drain_raw()
    ]


def test_equal_seeds_give_byte_equal_traffic_and_another_mote_changes_nothing_that_robots_sense(stage):
    first = recorded(stage, seed=7)
    assert {key.split("/")[-1] for key, _ in first} == {"can0", "scan", "rx", "clock", "truth"}
    assert recorded(stage, seed=7) == first
    assert recorded(stage, seed=8) != first
    few, more = (
        [one for one in each if one[0].endswith("/scan")] for each in (recorded(stage, seed=7, motes=1), first)
    )
    assert few == more


def test_in_live_the_same_arena_follows_its_commands():
    session = open_lockstep_session()
    endpoint = Endpoint(session, "test", LiveClock(), Drive.LIVE)
    arena = Arena(World(room(), [ArenaRobot(name="r1", start=Pose2D(1.0, 2.0, 0.0))], [], 1), endpoint)
    host = ZenohBus("r1/can0", session=session, team="test")
    wheels = dict(zip(SIGNALS, BASE.wheel_speeds_rad_s(Twist2D(0.3)), strict=True))
    number = itertools.count()

    def step() -> None:
        host.send(codec("WheelCommand").pack(next(number) % 256, **wheels))
        arena.step()
        while (frame := host.recv(timeout=PATIENCE_S)) is not None:
            if frame.arbitration_id == codec("WheelEncoders").arbitration_id:
                break
        assert frame is not None

    # A command that comes late, on a busy machine, finds the wheels stopped by their watchdog.
    until(lambda: arena.truth.robots[0].pose.x_m > 1.2, "the robot does not follow its commands", step=step)
    host.shutdown()
    arena.close()
    endpoint.close()
    session.close()
