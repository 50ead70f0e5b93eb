"""Each scenario that comes with robrain, run twice with equal seeds, links and faults on, has equal digests."""

import pytest

from robrain import LinkSpec, PartitionSpec, Scenario
from robrain.sim.faults.fault_spec import COORDINATOR, HARDWARE, PROCESS, WIRE, FaultKind, FaultMoment, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario_file import builtin_names

RUN_S = 2.0
FAULTS = (
    FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=0.5, until_s=1.0),
    FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=1.1, until_s=1.4),
    FaultSpec(robot=COORDINATOR, kind=FaultKind.DISK_FULL, at_s=0.2, until_s=0.9),
    FaultSpec(robot=COORDINATOR, kind=FaultKind.CLOCK_SKEW, at_s=0.5, until_s=0.9, skew_s=-0.3),
    FaultSpec(robot="r2", kind=FaultKind.DRAIN, at_s=0.3, within_s=0.4, soc=0.5),
    FaultSpec(robot="r2", kind=FaultKind.LIDAR_FREEZES, at_s=0.3, within_s=1.0),
    FaultSpec(robot="r2", kind=FaultKind.MOTORS_FAIL, at_s=0.1, on=FaultMoment.TASK_ASSIGNED),
    FaultSpec(robot="r2", kind=FaultKind.HANG, at_s=1.0, until_s=1.3),
    FaultSpec(robot="r1", kind=FaultKind.SLOW, at_s=1.2, until_s=1.8, period_s=0.2),
    FaultSpec(robot="r2", kind=FaultKind.LOSE, at_s=0.2, until_s=1.8, share=0.4),
    FaultSpec(robot=COORDINATOR, kind=FaultKind.REORDER, at_s=0.3, until_s=1.9, late_s=(0.0, 0.3)),
    FaultSpec(robot="r1", kind=FaultKind.DELAY, at_s=0.1, until_s=0.5, late_s=(0.0, 0.1)),
    FaultSpec(robot="r1", kind=FaultKind.PARTITION, at_s=1.5, until_s=1.8),
)
LINKS = LinkSpec(
    range_m=12.0, wall_db=6.0, loss=0.2, delay_s=0.01, bandwidth_bytes_s=500_000.0,
    partitions=(PartitionSpec(from_s=1.5, until_s=1.8, groups=(("r2",),)),),
)  # fmt: skip


def digest(scenario: Scenario) -> str:
    run = LockstepRun(scenario.world())
    try:
        while run.sim_time_s < RUN_S:
            run.tick()
    finally:
        summary = run.close()
    assert summary is not None
    return summary.digest


@pytest.mark.slow
@pytest.mark.parametrize(("name", "links"), [("arena_small", None), *((name, LINKS) for name in builtin_names())])
def test_equal_seeds_give_equal_digests(name: str, links: LinkSpec | None) -> None:
    scenario = Scenario.builtin(name).replace(faults=FAULTS, links=links)
    assert digest(scenario) == digest(scenario)


def test_the_faults_are_of_every_sort() -> None:
    kinds = {fault.kind for fault in FAULTS}
    assert kinds >= PROCESS | WIRE | {FaultKind.DISK_FULL, FaultKind.DRAIN}
    assert kinds & HARDWARE


@pytest.fixture(scope="module")
def digest_without_faults() -> str:
    return digest(Scenario.builtin("arena_small"))


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.kind} of {fault.robot}")
def test_each_of_the_faults_makes_a_difference_or_waits_to(fault: FaultSpec, digest_without_faults: str) -> None:
    quiet = {FaultKind.CLOCK_SKEW, FaultKind.DISK_FULL, FaultKind.DRAIN, FaultKind.LIDAR_FREEZES, FaultKind.MOTORS_FAIL}
    scenario = Scenario.builtin("arena_small")
    changed = digest(scenario.replace(faults=(fault,))) != digest_without_faults
    assert changed or fault.kind in quiet
