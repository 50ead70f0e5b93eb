"""Whether a run can have the faults of its scenario."""

from collections.abc import Sequence

from robrain.sim.errors import ScenarioError
from robrain.sim.faults.fault_spec import COORDINATOR, OF_ROBOTS, FaultSpec


def check_faults_alone(where: str, *, is_alone: bool) -> None:
    """Check that no other process joins a run with such faults: it could not be cut off from anybody.

    Raises:
        ScenarioError: one may; names `where`.

    """
    if not is_alone:
        raise ScenarioError(
            f"{where}: faults: expected a run that no other process can join, got one with a dashboard or a port to "
            "listen on: run it without them and look at its recording, or leave out faults that are not of hardware"
        )


def faults_refusal(faults: Sequence[FaultSpec], robots: Sequence[str]) -> str:
    """Why a run cannot have these faults, in one sentence; empty if it can."""
    for fault in faults:
        for name in (fault.robot, *fault.side):
            if name not in (*robots, COORDINATOR):
                there = f"r1 to r{len(robots)}"
                return f"no robot {name!r}; there are {there if fault.kind in OF_ROBOTS else f'{COORDINATOR}, {there}'}"
    return ""
