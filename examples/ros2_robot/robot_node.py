"""A ROS 2 robot without any robrain code: cmd_vel in; odom, scan, battery_state and TF out.

For tests it also publishes its true pose on ground_truth.

python robot_node.py --ros-args -p map:=../maps/clinic.yaml -p x:=0.0 -p y:=0.0 -r __ns:=/r7
"""

import math
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Quaternion, TransformStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, LaserScan
from simulated_robot import Battery, Body, FloorMap, Lidar, Pose, Twist

try:  # part of an installed ROS 2, not on PyPI
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:
    TFMessage = None

STEP_S = 0.02
LONGEST_STEP_S = 0.1
RANGE_MIN_M = 0.05
TEMPERATURE_C = 24.0


class RobotNode(Node):
    def __init__(self) -> None:
        super().__init__("ros2_robot")
        self.declare_parameter("map", "")
        for name, default in (("x", 0.0), ("y", 0.0), ("yaw", 0.0), ("slip", 0.01), ("soc", 0.9), ("noise", 0.01)):
            self.declare_parameter(name, default)
        for name, number in (("beams", 180), ("seed", 1)):
            self.declare_parameter(name, number)
        self.declare_parameter("range_max", 6.0)
        self.declare_parameter("scan_hz", 5.0)
        self.declare_parameter("odom_hz", 50.0)
        self.declare_parameter("holonomic", False)
        floor = FloorMap(Path(self._text("map")))
        start = Pose(self._number("x"), self._number("y"), self._number("yaw"))
        holonomic = self.get_parameter("holonomic").get_parameter_value().bool_value
        self.body = Body(floor, start, holonomic=holonomic, slip=self._number("slip"))
        self.lidar = Lidar(floor, self._whole("beams"), self._number("range_max"), self._number("noise"))
        self.battery = Battery(self._number("soc"))
        self._rng = np.random.default_rng(self._whole("seed"))
        self._stepped_s = time.monotonic()
        self._odometry = self.create_publisher(Odometry, "odom", 10)
        self._scan = self.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
        self._battery = self.create_publisher(BatteryState, "battery_state", 10)
        self._truth = self.create_publisher(PoseStamped, "ground_truth", 10)
        self._transforms = self.create_publisher(TFMessage, "/tf", 100) if TFMessage is not None else None
        self.create_subscription(TwistMessage, "cmd_vel", self._command, 10)
        self.create_timer(STEP_S, self._step)
        self.create_timer(1.0 / self._number("odom_hz"), self._tell_odometry)
        self.create_timer(1.0 / self._number("scan_hz"), self._tell_scan)
        self.create_timer(1.0, self._tell_battery)
        self.get_logger().info("the robot is there")

    def _text(self, name: str) -> str:
        return self.get_parameter(name).get_parameter_value().string_value

    def _number(self, name: str) -> float:
        return self.get_parameter(name).get_parameter_value().double_value

    def _whole(self, name: str) -> int:
        return self.get_parameter(name).get_parameter_value().integer_value

    def _command(self, message: TwistMessage) -> None:
        self.body.command(Twist(message.linear.x, message.linear.y, message.angular.z), time.monotonic())

    def _step(self) -> None:
        now_s = time.monotonic()
        dt_s, self._stepped_s = min(now_s - self._stepped_s, LONGEST_STEP_S), now_s
        self.body.step(now_s, dt_s, self._rng)
        self.battery.drain(self.body.velocity, dt_s)

    def _tell_odometry(self) -> None:
        body, stamp = self.body, self.get_clock().now().to_msg()
        odometry = Odometry()
        odometry.header.stamp, odometry.header.frame_id, odometry.child_frame_id = stamp, "odom", "base_link"
        pose, velocity = odometry.pose.pose, odometry.twist.twist
        pose.position.x, pose.position.y = body.odometry.x_m, body.odometry.y_m
        pose.orientation = _quaternion(body.odometry.yaw_rad)
        velocity.linear.x, velocity.linear.y = body.velocity.forward_m_s, body.velocity.left_m_s
        velocity.angular.z = body.velocity.yaw_rad_s
        self._odometry.publish(odometry)
        truth = PoseStamped()
        truth.header.stamp, truth.header.frame_id = stamp, "map"
        truth.pose.position.x, truth.pose.position.y = body.pose.x_m, body.pose.y_m
        truth.pose.orientation = _quaternion(body.pose.yaw_rad)
        self._truth.publish(truth)
        if self._transforms is not None:
            transform = TransformStamped(header=odometry.header, child_frame_id="base_link")
            transform.transform.translation.x, transform.transform.translation.y = body.odometry.x_m, body.odometry.y_m
            transform.transform.rotation = pose.orientation
            self._transforms.publish(TFMessage(transforms=[transform]))

    def _tell_scan(self) -> None:
        lidar, scan = self.lidar, LaserScan()
        scan.header.stamp, scan.header.frame_id = self.get_clock().now().to_msg(), "base_link"
        scan.angle_increment = 2.0 * math.pi / len(lidar.angles_rad)
        scan.angle_min, scan.angle_max = -math.pi, math.pi - scan.angle_increment
        scan.range_min, scan.range_max = RANGE_MIN_M, lidar.range_max_m
        scan.ranges = array("f", lidar.ranges_m(self.body.pose, self._rng).tobytes())
        self._scan.publish(scan)

    def _tell_battery(self) -> None:
        battery, state = self.battery, BatteryState()
        state.header.stamp = self.get_clock().now().to_msg()
        state.voltage, state.temperature = battery.voltage_v, TEMPERATURE_C
        state.current = -battery.current_a  # negative while discharging, by the definition of the message
        state.percentage, state.present = battery.soc, True
        state.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        state.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LION
        self._battery.publish(state)


def _quaternion(yaw_rad: float) -> Quaternion:
    return Quaternion(z=math.sin(0.5 * yaw_rad), w=math.cos(0.5 * yaw_rad))


def main() -> None:
    rclpy.init()
    node = RobotNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
