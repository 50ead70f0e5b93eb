"""A team that loses its coordinator."""

from collections.abc import Iterator

import pytest

from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.team_robots import LostTeam


@pytest.fixture
def lost() -> Iterator[LostTeam]:
    with open_lockstep_session() as session:
        team = LostTeam(session, 3)
        yield team
        team.close()
