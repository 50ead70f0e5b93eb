"""Stands for Nav2: an action server of NavigateToPose that turns to a goal and drives there by `odom` and `cmd_vel`."""

import math
import time
from contextlib import suppress

import rclpy
from geometry_msgs.msg import Twist
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

PERIOD_S = 0.05
ARRIVED_M, TURNED_RAD = 0.1, 0.1


class NavServer(Node):
    def __init__(self) -> None:
        super().__init__("nav_server")
        side_by_side = ReentrantCallbackGroup()
        self._odometry: Odometry | None = None
        self._latest: object = None
        self._wheels = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(Odometry, "odom", self._receive, 10, callback_group=side_by_side)
        self._server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self._drive,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=side_by_side,
        )

    def _receive(self, message: Odometry) -> None:
        self._odometry = message

    def _drive(self, goal: object) -> NavigateToPose.Result:
        self._latest = goal
        at = goal.request.pose.pose
        wanted_rad = 2.0 * math.atan2(at.orientation.z, at.orientation.w)
        while True:
            time.sleep(PERIOD_S)
            if goal.is_cancel_requested:
                self._wheels.publish(Twist())
                goal.canceled()
                return NavigateToPose.Result()
            if self._latest is not goal:  # a new goal takes the place of the one before
                goal.abort()
                return NavigateToPose.Result(error_msg="another goal has come")
            if self._odometry is None:
                continue
            here = self._odometry.pose.pose
            yaw_rad = 2.0 * math.atan2(here.orientation.z, here.orientation.w)
            left_x, left_y = at.position.x - here.position.x, at.position.y - here.position.y
            left_m = math.hypot(left_x, left_y)
            is_there = left_m < ARRIVED_M
            heading_rad = wanted_rad if is_there else math.atan2(left_y, left_x)
            turn_rad = math.remainder(heading_rad - yaw_rad, 2.0 * math.pi)
            if is_there and abs(turn_rad) < TURNED_RAD:
                self._wheels.publish(Twist())
                goal.succeed()
                return NavigateToPose.Result()
            command = Twist()
            command.angular.z = max(-1.0, min(1.0, 2.0 * turn_rad))
            command.linear.x = 0.0 if is_there else min(0.4, left_m) * max(0.0, math.cos(turn_rad)) ** 3
            self._wheels.publish(command)


def main() -> None:
    rclpy.init()
    executor = MultiThreadedExecutor(8)
    executor.add_node(NavServer())
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
