import pytest

from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import NeedsEnergy
from robrain.sim.firmware.battery import BatterySpec
from tests.plugins.behavior.errands import CHARGER, START, Errands

KNOWN = {"home": {"chargers": [{"x_m": CHARGER.x_m, "y_m": CHARGER.y_m, "yaw_rad": 0.0}]}}
FAR = Point2D(5.0, 3.0)


def usable(run: Errands, energy_j: float | None) -> None:
    """Have the robot believe that its battery surely gives so much; None: what it really believes."""
    energy = run.plugin("energy")
    if energy_j is None:
        del energy.usable_j
    else:
        energy.usable_j = lambda: energy_j


def behavior(run: Errands) -> str:
    return run.robot().board.behavior


def docked(run: Errands) -> bool:
    return run.arena.chargers.docked == [0]


@pytest.mark.slow
def test_a_robot_that_is_told_to_docks_within_5_cm_and_tells_what_the_charger_gave(errands):
    run = errands("recharge", "visit", parameters=KNOWN, hardware={"battery": BatterySpec(soc_at_start=0.7)})
    run.finish(Task(id="v", kind="visit", place=Point2D(2.5, 1.5)))
    before = run.robot().board.battery
    status = run.finish(
        Task(id="c", kind="recharge", place=CHARGER, parameters={"yaw_rad": 1.0, "until_soc": before.soc + 0.004}),
        300.0,
    )
    assert (status.state, status.why) == (TaskState.DONE, "")
    assert run.pose().distance_m(CHARGER) < 0.05
    assert status.result["docked_m"] < 0.05
    assert run.pose().yaw_rad == pytest.approx(1.0, abs=0.06)
    assert status.result["soc"] >= before.soc + 0.0035  # told to three places
    assert docked(run)
    gained_j = run.robot().board.battery.remaining_j - before.remaining_j
    assert status.result["charged_j"] > 0.5 * gained_j > 0.0
    assert 10.0 < status.result["energy_j"] < 400.0  # of the way to it


@pytest.mark.slow
def test_a_dock_that_is_not_quite_where_it_should_be_is_found(errands):
    run = errands("recharge", "visit", hardware={"battery": BatterySpec(soc_at_start=0.7)})
    beside = Point2D(CHARGER.x_m + 0.33, CHARGER.y_m)  # the contacts reach 0.25 m
    before = run.robot().board.battery.soc
    status = run.finish(Task(id="c", kind="recharge", place=beside, parameters={"until_soc": before + 0.003}), 300.0)
    assert (status.state, status.why) == (TaskState.DONE, "")
    assert docked(run)


@pytest.mark.slow
def test_robot_that_returns_a_task_for_lack_of_energy_goes_home_at_once(errands):
    run = errands("recharge", "visit", parameters=KNOWN)
    told = run.inbox(ROBOT_EVENT, plugin="home")
    run.offer(Task(id="v", kind="visit", place=FAR, service_s=60.0))
    run.run(3.0)
    usable(run, 500.0)  # enough for the way home with what it keeps for it, not for the task
    run.run(3.5)
    assert run.status().state is TaskState.CANCELLED
    assert isinstance(run.status().reason, NeedsEnergy)
    assert told.drain()[0].message.value.startswith("v needs ")
    assert behavior(run) == "recharge"
    usable(run, None)
    run.run(25.0)
    assert docked(run)


@pytest.mark.slow
def test_without_a_charger_the_robot_goes_back_to_where_it_started(errands):
    run = errands("recharge", "visit")
    run.finish(Task(id="v", kind="visit", place=FAR))
    usable(run, 500.0)
    run.run(25.0)
    assert run.pose().distance_m(START) < 0.3
    assert behavior(run) == "idle"
    here = run.path_m()
    run.run(10.0)
    assert run.path_m() == pytest.approx(here, abs=0.01)  # it is at home, and stays there
