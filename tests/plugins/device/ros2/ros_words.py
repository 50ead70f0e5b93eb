"""Messages of a ROS 2 robot as its plugins see them, without ROS."""

import math
from types import SimpleNamespace
from typing import Any

from robrain.protocol.clock import NS_PER_S
from robrain.protocol.model.geometry import Pose2D, Twist2D

STANDING = Twist2D()


def header(stamp_ns: int) -> Any:
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id="odom")


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return SimpleNamespace(x=x, y=y, z=z)


def odometry(pose: Pose2D, velocity: Twist2D = STANDING, *, stamp_ns: int = 0) -> Any:
    turned = SimpleNamespace(x=0.0, y=0.0, z=math.sin(pose.yaw_rad / 2), w=math.cos(pose.yaw_rad / 2))
    twist = SimpleNamespace(
        linear=vector(velocity.forward_m_s, velocity.left_m_s), angular=vector(z=velocity.yaw_rad_s)
    )
    return SimpleNamespace(
        header=header(stamp_ns),
        child_frame_id="base_link",
        pose=SimpleNamespace(pose=SimpleNamespace(position=vector(pose.x_m, pose.y_m), orientation=turned)),
        twist=SimpleNamespace(twist=twist),
    )


def scan(ranges_m: list[float], **changed: Any) -> Any:
    """A turn around the whole circle, counter-clockwise from −π."""
    step_rad = 2 * math.pi / max(len(ranges_m), 1)
    message = {
        "header": header(0),
        "angle_min": -math.pi,
        "angle_max": math.pi - step_rad,
        "angle_increment": step_rad,
        "time_increment": 0.0,
        "range_min": 0.1,
        "range_max": 8.0,
        "ranges": ranges_m,
    }
    return SimpleNamespace(**(message | changed))


def imu(
    rate_rad_s: float = 0.0,
    x_m_s2: float = 0.0,
    y_m_s2: float = 0.0,
    *,
    stamp_ns: int = 0,
    has_rate: bool = True,
    has_acceleration: bool = True,
) -> Any:
    return SimpleNamespace(
        header=header(stamp_ns),
        angular_velocity=vector(z=rate_rad_s),
        angular_velocity_covariance=[0.0 if has_rate else -1.0, *[0.0] * 8],
        linear_acceleration=vector(x_m_s2, y_m_s2, 9.8),
        linear_acceleration_covariance=[0.0 if has_acceleration else -1.0, *[0.0] * 8],
    )


def battery(
    voltage: float = 15.5, current: float = -1.0, temperature: float = 24.0, *, stamp_ns: int = 0, status: int = 0
) -> Any:
    return SimpleNamespace(
        header=header(stamp_ns), voltage=voltage, current=current, temperature=temperature, power_supply_status=status
    )
