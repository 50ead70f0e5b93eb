"""Each process of a team under `robrain up` is killed, then stopped: what fails is noticed and comes back in time."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bench.recovery import NOTICED_S, PARTS, SIGNALS, WELL_S, Recovered, RecoveryTeam, recovery_team

pytestmark = pytest.mark.system

SLACK = 4.0
"""Tests may run beside other work; `make bench` holds the bounds themselves."""


@pytest.fixture(scope="module")
def team(tmp_path_factory) -> Iterator[RecoveryTeam]:
    folder: Path = tmp_path_factory.mktemp("recovery")
    with recovery_team(folder) as found:
        yield found
    result = found.result
    assert result["given_up"] == []
    assert set(result["restarts"]) == set(PARTS)
    assert result["messages"] > 0
    assert len(list(folder.glob("recovery*.mcap"))) == 1 + result["restarts"]["recorder"]


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("part", PARTS)
def test_part_comes_back_and_no_acknowledged_task_is_lost(team, part: str, name: str) -> None:
    before = team.acknowledged.copy()
    found: Recovered = team.strike(part, name)
    assert found.noticed_s < SLACK * NOTICED_S[name]
    assert found.well_s < SLACK * WELL_S[name]
    assert len(team.acknowledged) == len(before) + 2
    assert team.lost() == []
