"""VDA 5050 both ways, with a real broker; vehicles and master are written from the standard alone."""

from pathlib import Path

import pytest

from tests.bench.vda5050 import MOSQUITTO, run_fleet, run_vehicles

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
