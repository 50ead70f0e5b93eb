"""Dead reckoning: adding up small displacements."""

import math

from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad


def moved(pose: Pose2D, displacement: Twist2D) -> Pose2D:
    """A pose after a small displacement in its own frame (a twist times the time it lasted: m, m, rad).

    Exact for constant velocity over the step: the exponential map of SE(2) (Solà, Deray, Atchuthan: A micro Lie
    theory for state estimation in robotics, 2018, equations 156 and 158).
    """
    forward, left, turn = displacement.forward_m_s, displacement.left_m_s, displacement.yaw_rad_s
    if abs(turn) < 1e-9:
        sine, cosine = 1.0, turn / 2
    else:
        sine, cosine = math.sin(turn) / turn, 2 * math.sin(turn / 2) ** 2 / turn
    dx, dy = sine * forward - cosine * left, cosine * forward + sine * left
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    yaw_rad = pose.yaw_rad + turn
    return Pose2D(
        pose.x_m + cos * dx - sin * dy,
        pose.y_m + sin * dx + cos * dy,
        yaw_rad if -math.pi < yaw_rad <= math.pi else wrap_angle_rad(yaw_rad),
    )


def chord(before: Pose2D, after: Pose2D) -> Twist2D:
    """The displacement (m, m, rad) between two poses, its way in the frame that faces halfway between their yaws."""
    dx, dy = after.x_m - before.x_m, after.y_m - before.y_m
    turn = wrap_angle_rad(after.yaw_rad - before.yaw_rad)
    cos, sin = math.cos(before.yaw_rad + turn / 2), math.sin(before.yaw_rad + turn / 2)
    return Twist2D(cos * dx + sin * dy, cos * dy - sin * dx, turn)


def moved_along(pose: Pose2D, displacement: Twist2D) -> Pose2D:
    """A pose after a displacement as `chord` gives it."""
    forward, left, turn = displacement.forward_m_s, displacement.left_m_s, displacement.yaw_rad_s
    cos, sin = math.cos(pose.yaw_rad + turn / 2), math.sin(pose.yaw_rad + turn / 2)
    return Pose2D(
        pose.x_m + cos * forward - sin * left,
        pose.y_m + sin * forward + cos * left,
        wrap_angle_rad(pose.yaw_rad + turn),
    )
