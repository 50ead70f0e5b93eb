"""Processes of a team under `robrain up` are killed or stopped: what fails is noticed and comes back."""

from pathlib import Path

import pytest

from robrain.deploy.supervision.part import COORDINATOR, STAND_BY
from tests.bench.recovery import NOTICED_S, PARTS, WELL_S, recovery_team

pytestmark = pytest.mark.system

SLACK = 4.0
"""Tests may run beside other work; `make bench` holds the bounds, and does all to each part of two teams."""
STRUCK = {"hub": "kill -9", "recorder": "kill -9", "arena": "kill -9", "coordinator": "SIGSTOP", "r1": "SIGSTOP"}
"""Parts of a secured team, which come back with their certificates, and how they fail."""


def test_parts_come_back_and_no_acknowledged_task_is_lost(tmp_path: Path) -> None:
    with recovery_team(tmp_path, secured=True, robots=1) as team:
        for number, (part, name) in enumerate(STRUCK.items(), 1):
            found = team.strike(part, name)
            assert found.noticed_s < SLACK * NOTICED_S[name], found
            assert found.well_s < SLACK * WELL_S[name], found
            assert len(team.acknowledged) == 2 * number
            assert team.lost() == []
    result = team.result
    assert result["given_up"] == []
    assert set(STRUCK) - {COORDINATOR} <= set(result["restarts"]) <= set(PARTS)
    assert result["restarts"].keys() & {COORDINATOR, STAND_BY}  # they may have changed places
    assert result["messages"] > 0
    # Each recorder that came up has a file of its own; on a busy machine one may be started again before it had one.
    assert 2 <= len(list(tmp_path.glob("recovery*.mcap"))) <= 1 + result["restarts"]["recorder"]
