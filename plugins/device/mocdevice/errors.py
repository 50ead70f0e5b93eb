"""What makes the motor controller's device fault; each is told to the team before, see `MocDevice.condition`.

PluginError
└── MotionFault        carries `.plugin`
    ├── BusFault       the bus is gone: silent, off, or not to be read
    └── MotorFault     the controller reports that its power stage has failed
"""

from robrain.agent.errors import PluginError


class MotionFault(PluginError):
    """The robot cannot be driven."""


class BusFault(MotionFault):
    """Nothing passes on the bus."""


class MotorFault(MotionFault):
    """The controller is there, and says that it has failed."""
