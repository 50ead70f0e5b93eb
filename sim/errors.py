"""Errors of the simulator.

RobrainError
├── ScenarioError             a scenario cannot be run; names file and key
└── RunFailed                 a strategy, allocator or other replaceable part failed during a run

MapError (a ValueError, in `sim/maps/floor_plan.py`) becomes a ScenarioError where a scenario is read.
"""

from robrain.protocol.errors import RobrainError


class ScenarioError(RobrainError):
    """A scenario cannot be read or built; the text names file, key and expected value."""


class RunFailed(RobrainError):
    """Code failed during a run, and a substitute replaced it; the text names the part and the line of its file."""
