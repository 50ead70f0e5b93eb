"""Runs with equal seeds have equal digests, whatever is switched on; and whatever is switched on makes a difference."""

from functools import cache
from typing import Any

import msgspec
import pytest

from robrain import LinkSpec, PartitionSpec, RobotHardware, Scenario
from robrain.sim.faults.fault_spec import COORDINATOR, HARDWARE, PROCESS, WIRE, FaultKind, FaultMoment, FaultSpec
from robrain.sim.firmware.disturbance import DelaySpec, DisturbanceSpec, FrameDelaySpec, PauseSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.surfaces import SurfaceSpec
from robrain.sim.motes.mote import MeshSpec
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.world.robot_specs import RobotSpec, RobotType
from tests.sim.traffic.test_traffic import DOOR, MOVER, PEOPLE, ROOMS

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


SMALL = Scenario.builtin("arena_small")
NETWORK = SMALL.network
FEATURES: dict[str, dict[str, Any]] = {
    "lidars that fail": {"hardware": RobotHardware(lidar=LidarSpec(dropout=0.1, outlier=0.02))},
    "glass and mirrors": {"surfaces": SurfaceSpec(glass_share=0.4, mirror_share=0.4, stretch_m=1.0)},
    "late frames": {"disturbance": DisturbanceSpec(can=FrameDelaySpec(late_s=(0.0, 0.03)))},
    "late scans": {"disturbance": DisturbanceSpec(scan=DelaySpec(late_s=(0.0, 0.15)))},
    "pauses": {"disturbance": DisturbanceSpec(agent=PauseSpec(per_minute=120, duration_s=(0.2, 0.8)))},
    "inertial unit": {"roster": (RobotSpec(hardware={"imu": {"bias_rad_s": 0.03, "noise_rad_s": 0.005}}),)},
    "other bases": {"roster": tuple(RobotSpec(type=kind) for kind in (RobotType.CAR, RobotType.SERIAL))},
    "mesh": {
        "network": msgspec.structs.replace(
            NETWORK, motes=msgspec.structs.replace(NETWORK.motes, mesh=MeshSpec(hops=6), gateways=("m1",))
        )
    },
}


@pytest.mark.slow
def test_equal_seeds_give_equal_digests_with_all_features_together() -> None:
    everything = {field: value for feature in FEATURES.values() for field, value in feature.items()}
    everything["roster"] = tuple(spec for feature in FEATURES.values() for spec in feature.get("roster", ()))
    late = [feature["disturbance"] for feature in FEATURES.values() if "disturbance" in feature]
    everything["disturbance"] = DisturbanceSpec(can=late[0].can, scan=late[1].scan, agent=late[2].agent)
    rooms = Scenario.from_toml(ROOMS + DOOR + "period_s = 1.0\n" + MOVER + PEOPLE)
    scenario = rooms.replace(robots=3, motes=6, faults=FAULTS, links=LINKS, **everything)
    assert digest(scenario) == digest(scenario)


@pytest.mark.slow
@pytest.mark.parametrize("feature", FEATURES.values(), ids=FEATURES)
def test_each_of_the_features_makes_a_difference(feature: dict[str, Any]) -> None:
    assert digest(SMALL.replace(**feature)) != plain_digest()


def test_the_faults_are_of_every_sort() -> None:
    kinds = {fault.kind for fault in FAULTS}
    assert kinds >= PROCESS | WIRE | {FaultKind.DISK_FULL, FaultKind.DRAIN}
    assert kinds & HARDWARE


@cache
def plain_digest() -> str:
    return digest(SMALL)
