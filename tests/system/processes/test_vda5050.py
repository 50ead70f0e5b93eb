"""VDA 5050 both ways, with a real broker; vehicles and master are written from the standard alone."""

from pathlib import Path
from typing import Any

import pytest

from tests.bench.vda5050 import MOSQUITTO, Stage, await_robots, connected, run_fleet, run_vehicles, start_robots
from tests.deploy.vda5050.master import Master
from tests.waiting import until

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto here: apt-get install mosquitto"),
]


@pytest.mark.parametrize("version", ["2.1.0", "3.0.0"])
def test_vehicles_do_each_task_once_though_processes_die_and_connections_break(version: str, tmp_path: Path) -> None:
    outcome = run_vehicles(20, version, tmp_path, disturb_each=4)
    assert outcome.is_good, outcome
    assert (outcome.done, outcome.disturbances) == (20, 4)


@pytest.mark.parametrize("version", ["2.1.0", "3.0.0"])
def test_robots_do_each_order_once_though_gateway_and_coordinator_die(version: str, tmp_path: Path) -> None:
    outcome = run_fleet(20, version, tmp_path, disturb_each=5)
    assert outcome.is_good, outcome
    assert outcome.done == 20
    assert outcome.disturbances >= 2


@pytest.mark.parametrize("version", ["2.1.0", "3.0.0"])
def test_a_master_pauses_resumes_and_cancels(version: str, tmp_path: Path) -> None:
    with Stage(tmp_path) as stage:
        stage.start_team()
        with connected(stage) as team:
            start_robots(stage, ["p0"], version)
            await_robots(team, 1)
            master = Master(stage.port, version, 1, ["p0"])
            vehicle = master.vehicles["p0"]

            def state() -> dict[str, Any]:
                master.receive()
                return vehicle.state or {}

            def act(kind: str) -> str:
                action = {"actionType": kind, "actionId": f"{kind}-1", "blockingType": "NONE"}
                master.send("p0", "instantActions", actions=[action])
                name = "actionStates" if version == "2.1.0" else "instantActionStates"
                ends = ("FINISHED", "FAILED")

                def ended() -> list[str]:
                    states = [one for one in state()[name] if one["actionId"] == f"{kind}-1"]
                    return [one["actionStatus"] for one in states if one["actionStatus"] in ends]

                return until(ended, f"{kind} does not end")[0]

            until(lambda: state() and vehicle.connection == "ONLINE", "the robot is no vehicle")
            vehicle.begin()
            vehicle.nodes = [vehicle.nodes[0], vehicle.node("far", 2, True, 400.0, 3.0)]
            vehicle.send()
            until(lambda: state()["driving"] or state()["orderId"] == "order/0", "it does not accept the order")
            assert act("startPause") == "FINISHED"
            until(lambda: state()["paused"] is True)
            assert act("stopPause") == "FINISHED"
            until(lambda: state()["paused"] is False)
            assert [one["nodeId"] for one in state()["nodeStates"]] == ["far"]
            assert act("cancelOrder") == "FINISHED"
            assert (state()["nodeStates"], state()["orderId"]) == ([], "order/0")
            assert act("dance") == "FAILED"
            assert state()["errors"][-1]["errorType"] in ("instantActionError", "INVALID_INSTANT_ACTION")
            master.client.disconnect()
            master.client.loop_stop()
            assert master.wrong_count == 0, list(master.wrong)
