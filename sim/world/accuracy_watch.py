"""Compares the robots' pose estimates and the team's map with the ground truth.

It subscribes to the robots' states and knows the simulated bodies. It sends nothing to the robots.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad
from robrain.protocol.model.localization.pose_accuracy import PoseAccuracyMeter
from robrain.protocol.model.mapping.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.mapping.grid_geometry import GridGeometry
from robrain.protocol.model.mapping.map_accuracy import measure_map_accuracy
from robrain.protocol.wire.clock import NS_PER_S
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.topics import ROBOT_STATE
from robrain.sim.robot.robot_body import RobotBody
from robrain.sim.world.referee import Referee

TRUE_POSE_PERIOD_S = 0.1
"""Seconds between two stored true poses; between them, poses are interpolated."""
KEPT_TRUE_POSES = 30
"""Number of true poses kept, three seconds: a state that arrives later is not compared."""
STATES = 1024
"""Room in the inbox for states of robots that are not the arena's."""
MAP_PERIOD_STEPS = 5
"""Calls of `step` from one measurement of the map to the next."""


class AccuracyWatch:
    """Measures the accuracy of the team's poses and map.

    Call `keep()` every `TRUE_POSE_PERIOD_S`, and `step()` five times a second.

    Args:
        robots: names, in the order of `bodies`.
        bodies: the simulated bodies, with the true poses.
        referee: keeps the team's map.
        walls: bool (H, W), the true walls.
        geometry: grid of the walls, arena frame.
        endpoint: receives the robots' states; its clock must be that of their stamps.

    """

    def __init__(
        self,
        robots: Sequence[str],
        bodies: Sequence[RobotBody],
        referee: Referee,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        endpoint: Endpoint,
    ) -> None:
        self._bodies = bodies
        self._referee = referee
        self._walls, self._geometry = walls, geometry
        self._clock = endpoint.clock
        self._meters = {name: PoseAccuracyMeter() for name in robots}
        self._index = {name: index for index, name in enumerate(robots)}
        self._true: deque[tuple[int, list[tuple[float, float, float]]]] = deque(maxlen=KEPT_TRUE_POSES)
        """Stamp, and x, y, yaw of each robot; the yaw is not wrapped."""
        self._inbox = Inbox(STATES + len(robots))
        self.at_task = [False] * len(bodies)
        """Whether each robot had a task in the last state that was heard, in the order of `bodies`."""
        self._steps = 0
        self._map_version = -1
        self._map_accuracy: MapAccuracy | None = None
        endpoint.subscribe(self._inbox, ROBOT_STATE)

    @property
    def map_accuracy(self) -> MapAccuracy | None:
        """Accuracy of the team's map at the last measurement; None before the first."""
        return self._map_accuracy

    def pose_accuracy(self, robot: str) -> PoseAccuracy:
        """Accuracy of a robot's poses at the last `step()` (KeyError: no such robot)."""
        return self._meters[robot].accuracy

    def keep(self) -> None:
        """Store the current true poses."""
        poses = [(body.x_m, body.y_m, body.yaw_rad) for body in self._bodies]
        self._true.append((self._clock.now_ns(), poses))

    def step(self) -> None:
        """Compare the states received since the last call; measure the map if it is due."""
        for received in self._inbox.drain():
            self._compare(received.message)
        if self._steps % MAP_PERIOD_STEPS == 0:
            self.measure_map()
        self._steps += 1

    def measure_map(self) -> None:
        """Compare the map with the true walls, if it has changed."""
        grid = self._referee.grid
        if grid.version != self._map_version:
            self._map_version = grid.version
            self._map_accuracy = measure_map_accuracy(grid.classes(), grid.geometry, self._walls, self._geometry)

    def _compare(self, state: RobotState) -> None:
        index = self._index.get(state.robot)
        if index is None:
            return
        self.at_task[index] = state.task is not None and not state.task.state.ended
        if state.pose is None:
            return
        true = self._true_pose(index, state.stamp_ns)
        if true is not None:
            time_s = state.stamp_ns / NS_PER_S
            self._meters[state.robot].note(time_s, state.pose, state.pose_covariance, state.lost, true)

    def _true_pose(self, index: int, stamp_ns: int) -> Pose2D | None:
        """T_arena_robot at a time; None before the first pose kept, or more than a period after the last."""
        later_ns, later = 0, None
        for kept_ns, poses in reversed(self._true):
            if kept_ns <= stamp_ns:
                if later is None and stamp_ns - kept_ns > TRUE_POSE_PERIOD_S * NS_PER_S:
                    return None
                share = (stamp_ns - kept_ns) / (later_ns - kept_ns) if later is not None else 0.0
                x_m, y_m, yaw_rad = poses[index]
                if later is not None and share > 0:
                    x_m += share * (later[0] - x_m)
                    y_m += share * (later[1] - y_m)
                    yaw_rad += share * (later[2] - yaw_rad)
                return Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad))
            later_ns, later = kept_ns, poses[index]
        return None
