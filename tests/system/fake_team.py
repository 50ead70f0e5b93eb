"""Two robots that circle in a room, a mote, and a coordinator's token: a team without an arena, for the dashboard."""

import math
import threading
import zlib

import numpy as np

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord, PluginEvent
from robrain.protocol.messages.robots.robot_messages import BatteryState, PlannedPath, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, HALT
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request
from robrain.protocol.wire.session import listening_at, open_session

ROBOTS = ("r1", "r2")
EVIL = "<script>document.title='run'</script><img src=x onerror=\"document.title='run'\">"
PAUSE_BETWEEN_S = 0.1


class FakeTeam:
    """Two robots that circle in a room which they have mapped before anybody looked on."""

    def __init__(self, listen: str = "tcp/127.0.0.1:0") -> None:
        self.session = open_session(mode="router", listen=(listen,))
        self.heard = Inbox()
        self._endpoint = Endpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fake-team")

    @property
    def address(self) -> str:
        return listening_at(self.session)[0]

    def __enter__(self) -> "FakeTeam":
        self._endpoint.subscribe(self.heard, HALT)
        self._endpoint.token(COORDINATOR_ALIVE)
        for robot in ROBOTS:
            self._endpoint.answer(ROBOT_MAP_WHOLE, whole_map, robot=robot)
            self._endpoint.token(robot_messages.ROBOT_ALIVE, robot=robot)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._endpoint.close()
        self.session.close()  # type: ignore[no-untyped-call]

    def _run(self) -> None:
        states = {robot: self._endpoint.publisher(robot_messages.ROBOT_STATE, robot=robot) for robot in ROBOTS}
        paths = {robot: self._endpoint.publisher(robot_messages.ROBOT_PATH, robot=robot) for robot in ROBOTS}
        truth = self._endpoint.publisher(ARENA_TRUTH)
        log = self._endpoint.publisher(ROBOT_LOG, robot="r1")
        events = self._endpoint.publisher(ROBOT_EVENT, robot="r1", plugin="p", event="e")
        readings = self._endpoint.publisher(MOTE_READING, mote="m1")
        tick = 0
        while not self._stop.wait(PAUSE_BETWEEN_S):
            tick += 1
            for number, robot in enumerate(ROBOTS):
                angle_rad = 0.1 * tick + math.pi * number
                pose = Pose2D(2.5 * math.cos(angle_rad), 1.5 * math.sin(angle_rad), angle_rad + math.pi / 2)
                battery = BatteryState(
                    voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=max(1 - tick / 1000, 0.0), remaining_j=1e5
                )
                state = RobotState(robot=robot, pose=pose, radius_m=0.2, battery=battery, behavior=EVIL)
                states[robot].put(state)
                paths[robot].put(PlannedPath(robot=robot, points=[Point2D(pose.x_m, pose.y_m), Point2D(0.0, 0.0)]))
            if tick % 10 == 1:
                log.put(LogRecord(robot="r1", level=EVIL, source=EVIL, text=EVIL))
                events.put(PluginEvent(robot="r1", plugin="p", event="e", value=EVIL))
                reading = MoteReading(
                    mote="m1", place=Point2D(0, 0), quantity=EVIL, value=1.0, voltage_v=2.0, rssi_dbm=-60, via=EVIL
                )
                readings.put(reading)
            truth.put(ArenaTruth(sim_time_s=0.2 * tick, robots=[], explored_fraction=tick % 300 / 300))


def whole_map(_: Request) -> MapPatch:
    cells = np.zeros((50, 80), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:, 60:] = -1
    return MapPatch(
        robot="r1",
        resolution_m=0.1,
        origin_x_m=-4.0,
        origin_y_m=-2.5,
        width=80,
        height=50,
        row=0,
        column=0,
        rows=50,
        columns=80,
        observed_ms=0,
        cells=zlib.compress(cells.tobytes()),
    )
