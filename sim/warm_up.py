"""Calls every kernel of the simulated robots once, so that none is compiled during a run."""

import numpy as np
import pymunk

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.firmware.motor_controller import WheelEncoders
from robrain.sim.firmware.power_model import LOAD, add_motion
from robrain.sim.robot.robot_body import RobotBodies, RobotBody
from robrain.sim.robot.wheels import Wheels, WheelSpec

TICK_S = 0.02


def warm_up() -> None:
    """Compile the kernels, or load compiled ones; a second call costs next to nothing."""
    wheels = Wheels.draw(OmniBase(), WheelSpec(), np.random.default_rng(0))
    space = pymunk.Space()
    bodies = RobotBodies(space, [RobotBody(space, wheels, Pose2D(0.0, 0.0, 0.0), 0.2)], TICK_S)
    bodies.drive()
    bodies.roll()
    add_motion(np.ones(1, LOAD), bodies.state, TICK_S)
    WheelEncoders(np.ones(1)).frames(bodies.turns_rad)
