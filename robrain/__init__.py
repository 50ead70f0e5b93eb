"""robrain: coordinate teams of mobile robots and sensor motes over Zenoh."""

import importlib
from typing import TYPE_CHECKING, Any

from robrain.protocol.kernel_cache import choose_kernel_cache as _choose_kernel_cache

if TYPE_CHECKING:
    from robrain.agent.action import Actions
    from robrain.agent.environment import Environment
    from robrain.agent.errors import (
        AccessDenied,
        HardwareAbsent,
        PluginBusy,
        PluginError,
        PluginInactive,
        PluginMissing,
    )
    from robrain.agent.event import Event
    from robrain.agent.plugin import Behavior, Device, Level, Plugin, Skill, Unit, external, unlocked
    from robrain.client.halting import HaltReport
    from robrain.client.hand import Hand
    from robrain.client.submission import BadTask
    from robrain.client.team import Team
    from robrain.coordinator.planning.policy import PlanningPolicy
    from robrain.lab.fork.fork_api import fork
    from robrain.lab.fork.fork_result import ForkResult
    from robrain.lab.sweep.sweep import SweepResult, sweep
    from robrain.plugins.behavior.errand import Errand, Failed
    from robrain.plugins.device.scan.interface import ScanInterface
    from robrain.plugins.unit.driver.interface import DriverInterface
    from robrain.protocol.errors import BadName, CallError, ErrorCode, NobodyThere, RobrainError, WireError
    from robrain.protocol.messages.motes.mote_messages import MoteReading
    from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionId, ActionProgress, Outcome
    from robrain.protocol.messages.robots.plugin_messages import PluginInfo
    from robrain.protocol.messages.robots.robot_messages import RobotState
    from robrain.protocol.messages.tasks.mission_messages import MissionStatus
    from robrain.protocol.messages.tasks.offer_messages import TaskEvent
    from robrain.protocol.messages.tasks.plan_messages import PlanningStatus
    from robrain.protocol.messages.tasks.task_messages import KnownKind, TaskExplanation, TaskFilter, TaskRecord
    from robrain.protocol.messages.team.team_messages import TeamState
    from robrain.protocol.model.energy_model import Work
    from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
    from robrain.protocol.model.rules.rule import Rule
    from robrain.protocol.model.tasks.objective import Objective
    from robrain.protocol.model.tasks.stock_kinds import TaskParameters
    from robrain.protocol.model.tasks.task import Task, TaskState
    from robrain.protocol.model.zone import Zone, ZoneKind
    from robrain.recording.export.recording import Recording, load
    from robrain.recording.reader.two_runs import TwoRuns, compare_runs
    from robrain.sim.errors import ScenarioError
    from robrain.sim.firmware.battery import BatterySpec
    from robrain.sim.firmware.disturbance import DisturbanceSpec, PauseSpec
    from robrain.sim.lockstep.result import RunResult
    from robrain.sim.maps.drawing import Block, FloorDrawing, Pillar, Wall, rasterise
    from robrain.sim.maps.surfaces import SurfaceSpec
    from robrain.sim.robot.robot_hardware import RobotHardware
    from robrain.sim.scenarios.driving import Progress
    from robrain.sim.scenarios.scenario import Scenario
    from robrain.sim.world.chargers import ChargerSpec
    from robrain.sim.world.link_spec import LinkSpec, PartitionSpec

__all__ = [
    "AccessDenied",
    "ActionEnd",
    "ActionId",
    "ActionProgress",
    "Actions",
    "BadName",
    "BadTask",
    "BatterySpec",
    "Behavior",
    "Block",
    "CallError",
    "ChargerSpec",
    "Device",
    "DisturbanceSpec",
    "DriverInterface",
    "Environment",
    "Errand",
    "ErrorCode",
    "Event",
    "Failed",
    "FloorDrawing",
    "ForkResult",
    "HaltReport",
    "Hand",
    "HardwareAbsent",
    "KnownKind",
    "Level",
    "LinkSpec",
    "MissionStatus",
    "MoteReading",
    "NobodyThere",
    "Objective",
    "Outcome",
    "PartitionSpec",
    "PauseSpec",
    "Pillar",
    "PlanningPolicy",
    "PlanningStatus",
    "Plugin",
    "PluginBusy",
    "PluginError",
    "PluginInactive",
    "PluginInfo",
    "PluginMissing",
    "Point2D",
    "Pose2D",
    "Progress",
    "Recording",
    "RobotHardware",
    "RobotState",
    "RobrainError",
    "Rule",
    "RunResult",
    "ScanInterface",
    "Scenario",
    "ScenarioError",
    "Skill",
    "SurfaceSpec",
    "SweepResult",
    "Task",
    "TaskEvent",
    "TaskExplanation",
    "TaskFilter",
    "TaskParameters",
    "TaskRecord",
    "TaskState",
    "Team",
    "TeamState",
    "Twist2D",
    "TwoRuns",
    "Unit",
    "Wall",
    "WireError",
    "Work",
    "Zone",
    "ZoneKind",
    "compare_runs",
    "external",
    "fork",
    "load",
    "rasterise",
    "sweep",
    "unlocked",
]

# Imported on first use: a robot has the plain install, without the simulator.
_NAMES = {
    "robrain.agent.action": ("Actions",),
    "robrain.agent.environment": ("Environment",),
    "robrain.agent.errors": (
        "AccessDenied",
        "HardwareAbsent",
        "PluginBusy",
        "PluginError",
        "PluginInactive",
        "PluginMissing",
    ),
    "robrain.agent.event": ("Event",),
    "robrain.agent.plugin": ("Behavior", "Device", "Level", "Plugin", "Skill", "Unit", "external", "unlocked"),
    "robrain.client.halting": ("HaltReport",),
    "robrain.client.hand": ("Hand",),
    "robrain.client.submission": ("BadTask",),
    "robrain.client.team": ("Team",),
    "robrain.coordinator.planning.policy": ("PlanningPolicy",),
    "robrain.recording.export.recording": ("Recording", "load"),
    "robrain.recording.reader.two_runs": ("TwoRuns", "compare_runs"),
    "robrain.lab.fork.fork_api": ("fork",),
    "robrain.lab.fork.fork_result": ("ForkResult",),
    "robrain.lab.sweep.sweep": ("SweepResult", "sweep"),
    "robrain.protocol.model.geometry": ("Point2D", "Pose2D", "Twist2D"),
    "robrain.protocol.model.tasks.objective": ("Objective",),
    "robrain.plugins.behavior.errand": ("Errand", "Failed"),
    "robrain.plugins.device.scan.interface": ("ScanInterface",),
    "robrain.plugins.unit.driver.interface": ("DriverInterface",),
    "robrain.protocol.model.energy_model": ("Work",),
    "robrain.protocol.model.tasks.stock_kinds": ("TaskParameters",),
    "robrain.protocol.model.tasks.task": ("Task", "TaskState"),
    "robrain.protocol.model.zone": ("Zone", "ZoneKind"),
    "robrain.protocol.errors": ("BadName", "CallError", "ErrorCode", "NobodyThere", "RobrainError", "WireError"),
    "robrain.protocol.messages.motes.mote_messages": ("MoteReading",),
    "robrain.protocol.messages.tasks.offer_messages": ("TaskEvent",),
    "robrain.protocol.messages.tasks.plan_messages": ("PlanningStatus",),
    "robrain.protocol.messages.robots.action_messages": ("ActionEnd", "ActionId", "ActionProgress", "Outcome"),
    "robrain.protocol.messages.robots.plugin_messages": ("PluginInfo",),
    "robrain.protocol.messages.robots.robot_messages": ("RobotState",),
    "robrain.protocol.messages.tasks.task_messages": ("KnownKind", "TaskFilter", "TaskRecord", "TaskExplanation"),
    "robrain.protocol.messages.team.team_messages": ("TeamState",),
    "robrain.sim.world.chargers": ("ChargerSpec",),
    "robrain.sim.firmware.disturbance": ("DisturbanceSpec", "PauseSpec"),
    "robrain.sim.world.link_spec": ("LinkSpec", "PartitionSpec"),
    "robrain.sim.errors": ("ScenarioError",),
    "robrain.sim.firmware.battery": ("BatterySpec",),
    "robrain.sim.maps.drawing": ("Block", "FloorDrawing", "Pillar", "Wall", "rasterise"),
    "robrain.sim.lockstep.result": ("RunResult",),
    "robrain.sim.robot.robot_hardware": ("RobotHardware",),
    "robrain.sim.scenarios.driving": ("Progress",),
    "robrain.sim.scenarios.scenario": ("Scenario",),
    "robrain.sim.maps.surfaces": ("SurfaceSpec",),
    "robrain.protocol.messages.tasks.mission_messages": ("MissionStatus",),
    "robrain.protocol.model.rules.rule": ("Rule",),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}


_choose_kernel_cache()


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'robrain' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
