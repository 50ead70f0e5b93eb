"""Results of a run, as printed by `robrain run --json`."""

import msgspec

from robrain.protocol.messages.maps.map_messages import ExplorationLeft
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.reasons import IdleReason
from robrain.sim.world.referee import FloorLeft
from robrain.sim.world.scenario_tasks import TaskOutcome
from robrain.sim.world.time_use import TimeUse


class RobotResult(msgspec.Struct, frozen=True, kw_only=True):
    """Results of one robot; the pose is the true one, arena frame."""

    name: str
    distance_m: float
    energy_j: float
    collisions: int
    pose: Pose2D
    time_use: TimeUse = TimeUse()
    """Its use of time."""
    pose_accuracy: PoseAccuracy | None = None
    """Accuracy of its poses over the run."""
    idle: IdleReason | None = None
    """Reason why it was idle when the run ended, by the coordinator; None if it was not."""


class RunResult(msgspec.Struct, frozen=True, kw_only=True):
    """Results of a run."""

    scenario: str
    seed: int
    robots: int
    motes: int
    ended: str
    """Reason for the end of the run: `explored`, `nothing_left`, `tasks_ended`, `time_limit` or `interrupted`."""
    sim_time_s: float
    wall_time_s: float
    """Wall time of the run itself; time before the first tick is `setup_time_s`."""
    setup_time_s: float
    real_time_factor: float
    explored_fraction: float
    """Share of the reachable floor that the team's maps cover."""
    floor_left: list[FloorLeft] = []
    """Regions of floor that were not seen or cannot be reached, and why: by the true floor plan."""
    exploration_left: ExplorationLeft | None = None
    """The same by the team's map; None if no coordinator ran at the end or nothing was mapped."""
    map_accuracy: MapAccuracy | None = None
    """Accuracy of the team's map at the end; None if nothing was mapped."""
    overlap: float = 0.0
    """Area that each robot has seen, summed over the robots, over the area that any has seen, less one."""
    explored_curve: list[tuple[float, float]]
    """Pairs of sim_time_s and explored fraction."""
    explored_percent_s: dict[int, float] = {}
    """Simulated time at which 50, 90, 95 and 99 % were first explored, without shares that the run did not reach."""
    distance_m: float
    energy_j: float
    collisions: int
    wall_overlap_m: float
    """Greatest depth of a robot's footprint inside a wall, at the resolution of the map."""
    per_robot: list[RobotResult]
    messages: int
    """Messages that the recorder received."""
    outside_messages: int
    """Messages from other processes; 0 in a run that can be repeated."""
    mote_readings: int
    tasks: list[TaskOutcome] = []
    """Outcomes of the scenario's tasks, in the order of its file."""
    links: LinkCounters | None = None
    """Counters of messages between robots and coordinator; None if every component receives all messages."""
    recording: str | None
    digest: str
    """SHA-256 over every recorded message; ends in `+outside:N` if some came from other processes."""
