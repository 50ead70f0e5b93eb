"""A large team for the dashboard's benchmark: 100 robots that circle and 400 motes, without an arena.

`python -m tests.bench.dashboard_team` prints where it listens, and goes on until it is ended.
"""

import math
import signal
import sys
import threading
import zlib

import msgspec
import numpy as np

from robrain.protocol.clock import LiveClock
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import BatteryState, PlannedPath, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, ARENA_TRUTH, ArenaTruth, Scan
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, RobotSummary, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.energy_models import energy_model

ROBOTS, MOTES = 100, 400
SIZE_M = 60.0
CELL_M = 0.2
MODEL = energy_model(
    8.0,
    2.0,
    5.0,
    1.0,
    4.0,
    covariance=(0.01,) * 15,
    residual_w2_s=0.1,
    relative_sd=0.1,
    path_ratio=1.1,
    packet_j=0.001,
    usable_j=6e4,
    power_w=12.0,
    usual_power_w=12.0,
)


class LargeTeam:
    """Says what such a team would: states at 10 Hz, scans at 5, paths each two seconds, readings each four."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._robots = [f"r{number}" for number in range(1, ROBOTS + 1)]
        rng = np.random.default_rng(1)
        places = rng.uniform(2.0, SIZE_M - 2.0, (ROBOTS, 2))
        self._middles = [Point2D(float(x), float(y)) for x, y in places]
        self._mote_places = [Point2D(float(x), float(y)) for x, y in rng.uniform(1.0, SIZE_M - 1.0, (MOTES, 2))]
        self._nearest = [
            self._robots[min(range(ROBOTS), key=lambda index: self._middles[index].distance_m(place))]
            for place in self._mote_places
        ]
        self._ranges_mm = [[int(mm) for mm in rng.integers(500, 6000, 180)] for _ in range(10)]
        self._states = [endpoint.publisher(robot_messages.ROBOT_STATE, robot=robot) for robot in self._robots]
        self._paths = [endpoint.publisher(robot_messages.ROBOT_PATH, robot=robot) for robot in self._robots]
        self._scans = [endpoint.publisher(ARENA_SCAN, robot=robot) for robot in self._robots]
        self._readings = [endpoint.publisher(MOTE_READING, mote=f"m{number}") for number in range(1, MOTES + 1)]
        self._truth = endpoint.publisher(ARENA_TRUTH)
        self._team = endpoint.publisher(COORDINATOR_STATE)
        endpoint.token(COORDINATOR_ALIVE)
        whole = msgspec.json.encode(whole_map())
        endpoint.answer(ROBOT_MAP_WHOLE, lambda _: whole, robot=self._robots[0])
        for robot in self._robots:
            endpoint.token(robot_messages.ROBOT_ALIVE, robot=robot)

    def tick(self, number: int) -> None:
        """A tenth of a second."""
        for index, robot in enumerate(self._robots):
            pose = self._pose(index, number)
            self._states[index].put(self._state(robot, pose))
            if (number + index) % 20 == 0:
                ends = [Point2D(pose.x_m, pose.y_m), self._middles[index]]
                self._paths[index].put(PlannedPath(robot=robot, points=ends))
            if (number + index) % 2 == 0:
                scan = Scan(robot=robot, angle_min_rad=0.0, angle_increment_rad=math.tau / 180, range_max_m=6.0,
                            ranges_mm=self._ranges_mm[index % 10])  # fmt: skip
                self._scans[index].put(scan)
        for mote in range(number % 40, MOTES, 40):
            reading = MoteReading(mote=f"m{mote + 1}", place=self._mote_places[mote], quantity="temperature_c",
                                  value=20.0 + mote % 9, voltage_v=2.2 + mote % 10 / 10, rssi_dbm=-60.0 - mote % 30,
                                  via=self._nearest[mote], sequence=number % 65536)  # fmt: skip
            self._readings[mote].put(reading)
        self._truth.put(ArenaTruth(sim_time_s=number / 10, robots=[], explored_fraction=min(1.0, number / 3000)))
        if number % 5 == 0:
            self._team.put(TeamState(robots=[RobotSummary(name=robot, up=True, age_s=0.1) for robot in self._robots]))

    def _pose(self, index: int, number: int) -> Pose2D:
        angle_rad = 0.02 * number + index
        middle = self._middles[index]
        x_m, y_m = middle.x_m + 1.5 * math.cos(angle_rad), middle.y_m + 1.5 * math.sin(angle_rad)
        return Pose2D(x_m, y_m, angle_rad + math.pi / 2)

    def _state(self, robot: str, pose: Pose2D) -> RobotState:
        battery = BatteryState(voltage_v=24.0, current_a=0.5, temperature_c=30.0, soc=0.8, remaining_j=5e4)
        return RobotState(
            robot=robot,
            pose=pose,
            pose_covariance=(0.01, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.01),
            velocity=Twist2D(0.3, 0.0, 0.2),
            radius_m=0.2,
            battery=battery,
            energy=MODEL,
            behavior="explore",
        )


def whole_map() -> MapPatch:
    """A hall with a grid of rooms."""
    cells_a_side = round(SIZE_M / CELL_M)
    cells = np.zeros((cells_a_side, cells_a_side), np.int8)
    for at in range(0, cells_a_side, 50):
        cells[at, :] = cells[:, at] = 100
    for at in range(25, cells_a_side, 50):
        cells[at - 4 : at + 4, :] = np.where(cells[at - 4 : at + 4, :] == 100, 0, cells[at - 4 : at + 4, :])
        cells[:, at - 4 : at + 4] = np.where(cells[:, at - 4 : at + 4] == 100, 0, cells[:, at - 4 : at + 4])
    return MapPatch(robot="r1", resolution_m=CELL_M, origin_x_m=0.0, origin_y_m=0.0, width=cells_a_side,
                    height=cells_a_side, row=0, column=0, rows=cells_a_side, columns=cells_a_side, observed_ms=0,
                    cells=zlib.compress(cells.tobytes()))  # fmt: skip


def main() -> None:
    """Be a team until ended."""
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    session = open_session(mode="router", listen=("tcp/127.0.0.1:0",))
    endpoint = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    team = LargeTeam(endpoint)
    sys.stdout.write(listening_at(session)[0] + "\n")
    sys.stdout.flush()
    number = 0
    while not stop.wait(0.1):
        number += 1
        team.tick(number)
    endpoint.close()
    session.close()


if __name__ == "__main__":
    main()
