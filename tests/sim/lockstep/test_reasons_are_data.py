"""Simulated robots with small batteries plan, charge and work the same whatever their reasons are called."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.plan_messages import COORDINATOR_CHARGES, TASK_ESTIMATES, TASK_PROBLEM
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskSubmission
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.reader.reading import read_messages
from robrain.sim.firmware.battery import BatterySpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec
from tests.random_words import MEANINGLESS, MISLEADING, speak_at_random, wordless

PLACES = ((1.0, 1.0), (7.0, 1.0), (4.2, 3.0), (7.2, 3.4), (3.4, 5.2), (1.2, 5.0))
EXPLORED_S, END_S = 8.0, 28.0
HEARD = (TASK_EVENT, TASK_ESTIMATES, TASK_PROBLEM, COORDINATOR_CHARGES, COORDINATOR_STATE, ROBOT_STATE, ROBOT_PATH)
SEED = 3


def what_is_said(recording: Path) -> list[tuple[str, Any]]:
    """All that was said by coordinator and robots, words left out."""
    scenario = Scenario.builtin("arena_small").replace(
        robots=2,
        motes=0,
        seed=SEED,
        chargers=(ChargerSpec(place_m=(0.7, 0.7), power_w=90.0),),
        hardware=RobotHardware(battery=BatterySpec(capacity_wh=2.0, soc_at_start=0.28, charge_a=5.0)),
    )
    run = LockstepRun(scenario.world(), planning=PlanningPolicy(), record=recording)
    asker = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP)
    try:
        while run.sim_time_s < EXPLORED_S:
            run.tick()
        for number, (x_m, y_m) in enumerate(PLACES):
            task = Task(id=f"t{number}", kind="visit", place=Point2D(x_m, y_m), service_s=15.0)
            asker.ask(TASK_SUBMIT, TaskSubmission(task=task))
        while run.sim_time_s < END_S:
            run.tick()
    finally:
        asker.close()
        run.close()
    return [
        (one.topic_key, wordless(msgspec.json.decode(one.payload)))
        for one in read_messages(recording)
        if any(topic.parse(one.topic_key) is not None for topic in HEARD)
    ]


@pytest.fixture(scope="module")
def as_it_went(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Any]]:
    return what_is_said(tmp_path_factory.mktemp("spoken") / "run.mcap")


@pytest.mark.slow
def test_the_run_has_charges_plans_and_reasons(as_it_went) -> None:
    events = [message for key, message in as_it_went if "task/" in key and "state" in message]
    kinds = {message["task"]["kind"] for message in events}
    codes = {message["reason"]["code"] for message in events if message["reason"] is not None}
    assert kinds == {"explore", "visit", "recharge"}
    assert "waits_for_charge" in codes
    assert any(key.endswith("charges") and message["charges"] for key, message in as_it_went)


@pytest.mark.slow
def test_the_run_is_the_same_whatever_the_reasons_are_called(as_it_went, monkeypatch, tmp_path) -> None:
    said = speak_at_random(monkeypatch, SEED, MISLEADING + MEANINGLESS)
    told = what_is_said(tmp_path / "run.mcap")
    assert len(set(said)) > 5
    assert told == as_it_went
