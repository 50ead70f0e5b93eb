from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robrain.client.team import Team
from tests.ros_domain import Domain
from tests.system.conftest import Commands

if TYPE_CHECKING:
    from tests.system.ros2.ros_robot import Listener, RosRobot

collect_ignore = ["interface_client.py", "nav_server.py"]
"""Programs that tests start."""
LACKING = "ROS 2 is not installed here: pip install 'robrain[ros2]'"


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[Domain]:
    pytest.importorskip("rclpy", reason=LACKING)
    domain = Domain()
    for name, value in domain.variables.items():
        monkeypatch.setenv(name, value)
    yield domain
    domain.close()


@pytest.fixture
def ros_robot(domain: Domain, tmp_path: Path) -> Iterator[Callable[..., "RosRobot"]]:
    """Starts a ROS 2 robot in the room."""
    from tests.system.ros2.ros_robot import RosRobot, draw_room

    with ExitStack() as closing:

        def build(**settings: object) -> "RosRobot":
            robot = RosRobot(draw_room(tmp_path), domain, **settings)
            closing.callback(robot.kill)
            robot.start()
            return robot

        yield build


@pytest.fixture
def listener(domain: Domain) -> Iterator["Listener"]:
    from tests.system.ros2.ros_robot import Listener

    listener = Listener(domain)
    yield listener
    listener.close()


@pytest.fixture
def coordinator(commands: Commands) -> str:
    """A coordinator that is its team's hub; its endpoint."""
    endpoint = commands.hub.endpoint
    process = commands.start("coordinator", "--listen", endpoint)
    commands.line_with(process, "coordinator: of team default")
    return endpoint


@pytest.fixture
def team(coordinator: str) -> Iterator[Team]:
    with Team.connect(coordinator) as team:
        yield team
