"""Each process of a team under `robrain up` is killed, then stopped: what fails is noticed and comes back in time."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.deploy.supervision.part import COORDINATOR, STAND_BY
from tests.bench.recovery import NOTICED_S, PARTS, SIGNALS, WELL_S, Recovered, RecoveryTeam, recovery_team

pytestmark = pytest.mark.system

SLACK = 4.0
"""Tests may run beside other work; `make bench` holds the bounds themselves, and stops parts of a secured team too."""


def team_of(folder: Path, *, secured: bool, struck: int) -> Iterator[RecoveryTeam]:
    with recovery_team(folder, secured=secured) as found:
        yield found
    result = found.result
    assert result["given_up"] == []
    # Coordinator and stand-by change places, so that one of the two may have been struck both times.
    assert set(PARTS) - {COORDINATOR, STAND_BY} <= set(result["restarts"]) <= set(PARTS)
    assert sum(result["restarts"].values()) >= struck
    assert result["messages"] > 0
    # Each recorder that came up has a file of its own; on a busy machine one may be started again before it had one.
    assert 2 <= len(list(folder.glob("recovery*.mcap"))) <= 1 + result["restarts"]["recorder"]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RecoveryTeam]:
    yield from team_of(tmp_path_factory.mktemp("recovery"), secured=False, struck=len(PARTS) * len(SIGNALS))


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RecoveryTeam]:
    yield from team_of(tmp_path_factory.mktemp("secured-recovery"), secured=True, struck=len(PARTS))


def strike(team: RecoveryTeam, part: str, name: str) -> None:
    before = team.acknowledged.copy()
    found: Recovered = team.strike(part, name)
    assert found.noticed_s < SLACK * NOTICED_S[name]
    assert found.well_s < SLACK * WELL_S[name]
    assert len(team.acknowledged) == len(before) + 2
    assert team.lost() == []


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("part", PARTS)
def test_part_comes_back_and_no_acknowledged_task_is_lost(plain: RecoveryTeam, part: str, name: str) -> None:
    strike(plain, part, name)


@pytest.mark.parametrize("part", PARTS)
def test_killed_part_of_a_secured_team_comes_back_with_its_certificate(secured: RecoveryTeam, part: str) -> None:
    strike(secured, part, "kill -9")
