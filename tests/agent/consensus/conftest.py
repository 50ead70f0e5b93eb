"""A team that loses its coordinator."""

from collections.abc import Iterator

import pytest

from tests.coordinator.team_robots import LostTeam


@pytest.fixture
def lost(lockstep_session) -> Iterator[LostTeam]:
    team = LostTeam(lockstep_session, 3)
    yield team
    team.close()
