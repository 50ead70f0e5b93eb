"""Each process of a team under `robrain up` is killed, some are stopped: what fails is noticed and comes back."""

from pathlib import Path

import pytest

from robrain.deploy.supervision.part import COORDINATOR, STAND_BY
from tests.bench.recovery import NOTICED_S, PARTS, WELL_S, recovery_team

pytestmark = pytest.mark.system

SLACK = 4.0
"""Tests may run beside other work; `make bench` holds the bounds themselves, and does all to both teams."""
STRUCK = {
    "plain": [("hub", "kill -9"), ("hub", "SIGSTOP"), ("coordinator", "SIGSTOP"), ("r1", "SIGSTOP")],
    "secured": [(part, "kill -9") for part in PARTS],
}
"""Parts of a team, and how they fail: what is killed in a secured team comes back with its certificate."""


@pytest.mark.parametrize("kind", STRUCK)
def test_parts_come_back_and_no_acknowledged_task_is_lost(tmp_path: Path, kind: str) -> None:
    with recovery_team(tmp_path, secured=kind == "secured", robots=1) as team:
        for number, (part, name) in enumerate(STRUCK[kind], 1):
            found = team.strike(part, name)
            assert found.noticed_s < SLACK * NOTICED_S[name], found
            assert found.well_s < SLACK * WELL_S[name], found
            assert len(team.acknowledged) == 2 * number
            assert team.lost() == []
    struck = [part for part, _ in STRUCK[kind]]
    result = team.result
    assert result["given_up"] == []
    # Coordinator and stand-by change places, so that one of the two may have been struck both times.
    assert set(struck) - {COORDINATOR, STAND_BY} <= set(result["restarts"]) <= set(PARTS)
    assert sum(result["restarts"].values()) >= len(struck)
    assert result["messages"] > 0
    # Each recorder that came up has a file of its own; on a busy machine one may be started again before it had one.
    files = len(list(tmp_path.glob("recovery*.mcap")))
    assert 1 + struck.count("recorder") <= files <= 1 + result["restarts"].get("recorder", 0)
