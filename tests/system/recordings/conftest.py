"""A recording that tests which read one share."""

from pathlib import Path

import pytest

from robrain import Scenario


@pytest.fixture(scope="session")
def depot_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two robots and six motes in the depot, for some seconds; not to be changed."""
    path = tmp_path_factory.mktemp("depot") / "run.mcap"
    Scenario.builtin("depot").replace(robots=2, motes=6).run(time_limit_s=10.0, record=path)
    return path
