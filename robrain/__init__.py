"""robrain: coordinate teams of mobile robots and sensor motes over Zenoh."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robrain.deploy.task_client import TaskClient
    from robrain.sim.result import RunResult
    from robrain.sim.scenario import Progress, Scenario

__all__ = ["Progress", "RunResult", "Scenario", "TaskClient"]

# Imported on first use: a robot has the plain install, without the simulator.
_HOMES = {
    "Progress": "robrain.sim.scenario",
    "RunResult": "robrain.sim.result",
    "Scenario": "robrain.sim.scenario",
    "TaskClient": "robrain.deploy.task_client",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'robrain' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
