"""robrain: coordinate teams of mobile robots and sensor motes over Zenoh."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robrain.coordinator.planning.policy import Method, PlanningPolicy
    from robrain.coordinator.recording.recording import Recording, load
    from robrain.deploy.lockstep_team import LockstepTeam
    from robrain.deploy.task_client import TaskClient
    from robrain.protocol.model.geometry import Point2D
    from robrain.protocol.model.objective import Objective
    from robrain.protocol.model.task import (
        Collect,
        Inspect,
        Monitor,
        Recharge,
        Relay,
        Replace,
        Sense,
        TaskState,
        Visit,
    )
    from robrain.sim.chargers import ChargerSpec
    from robrain.sim.firmware.battery import BatterySpec
    from robrain.sim.result import RunResult
    from robrain.sim.robot_hardware import RobotHardware
    from robrain.sim.scenario import Progress, Scenario

__all__ = [
    "BatterySpec",
    "ChargerSpec",
    "Collect",
    "Inspect",
    "LockstepTeam",
    "Method",
    "Monitor",
    "Objective",
    "PlanningPolicy",
    "Point2D",
    "Progress",
    "Recharge",
    "Recording",
    "Relay",
    "Replace",
    "RobotHardware",
    "RunResult",
    "Scenario",
    "Sense",
    "TaskClient",
    "TaskState",
    "Visit",
    "load",
]

# Imported on first use: a robot has the plain install, without the simulator.
_HOMES = {
    "BatterySpec": "robrain.sim.firmware.battery",
    "ChargerSpec": "robrain.sim.chargers",
    "Collect": "robrain.protocol.model.task",
    "Inspect": "robrain.protocol.model.task",
    "LockstepTeam": "robrain.deploy.lockstep_team",
    "Method": "robrain.coordinator.planning.policy",
    "Monitor": "robrain.protocol.model.task",
    "Objective": "robrain.protocol.model.objective",
    "PlanningPolicy": "robrain.coordinator.planning.policy",
    "Point2D": "robrain.protocol.model.geometry",
    "Progress": "robrain.sim.scenario",
    "Recharge": "robrain.protocol.model.task",
    "Recording": "robrain.coordinator.recording.recording",
    "Relay": "robrain.protocol.model.task",
    "Replace": "robrain.protocol.model.task",
    "RobotHardware": "robrain.sim.robot_hardware",
    "RunResult": "robrain.sim.result",
    "Scenario": "robrain.sim.scenario",
    "Sense": "robrain.protocol.model.task",
    "TaskClient": "robrain.deploy.task_client",
    "TaskState": "robrain.protocol.model.task",
    "Visit": "robrain.protocol.model.task",
    "load": "robrain.coordinator.recording.recording",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'robrain' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
