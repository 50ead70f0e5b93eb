"""A team without an arena, which the tests of a module look at."""

from collections.abc import Iterator

import pytest

from tests.system.fake_team import FakeTeam


@pytest.fixture(scope="module")
def everybody() -> Iterator[FakeTeam]:
    with FakeTeam() as team:
        yield team


@pytest.fixture
def team(everybody: FakeTeam) -> FakeTeam:
    everybody.heard.drain()
    return everybody
