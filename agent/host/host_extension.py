"""Host extensions: functions of a robot's host beyond running plugins, such as allocation without a coordinator.

Another distribution brings an extension by an entry point in the group `robrain.host_extensions`; each robot's host
calls it once, when the host is made:

    [project.entry-points."robrain.host_extensions"]
    beacon = "my_team.beacon:Beacon"
"""

from collections.abc import Callable
from typing import Protocol

from robrain.agent.board import Board
from robrain.agent.host.robot_file import RobotFile
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.clock import Clock
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.reasons import OfferRefusal
from robrain.protocol.registry import Registry
from robrain.protocol.wire.endpoint import Endpoint


class ExtendedHost(Protocol):
    """The part of a robot's host that an extension uses."""

    name: str
    robot_file: RobotFile
    wire: Endpoint
    clock: Clock
    board: Board
    desk: RobotTasks

    def follows(self, summary: TeamState) -> bool:
        """Whether a summary is of a coordinator that leads, by the knowledge of all extensions."""


class HostExtension:
    """A part of one robot's host. Each function runs in the host's step; by default it does nothing."""

    def start(self) -> None:
        """Declare queries and subscriptions; the plugins run."""

    def follows(self, summary: TeamState) -> bool:
        """Whether a summary is of a coordinator that leads, by this extension's knowledge."""
        return True

    def receive_summary(self, summary: TeamState, now_ns: int) -> bool:
        """Receive a coordinator's summary. If this returns False, the summary renews no lease."""
        return True

    def restart_silence(self, now_ns: int) -> None:
        """Count the silence of others from now on: the robot's process was stopped."""

    def offer_refusal(self, task_id: str, now_ns: int) -> OfferRefusal | None:
        """Why the offer of a task is refused; None if the extension allows it."""
        return None

    def withdrawal_refusal(self, now_ns: int) -> OfferRefusal | None:
        """Why a task is not withdrawn; None if the extension allows it."""
        return None

    def step(self, now_ns: int, *, may_begin: bool) -> None:
        """Run due actions.

        Args:
            now_ns: the time.
            may_begin: whether the robot may begin tasks: it is not halted.

        """

    def extend_state(self, state: RobotState) -> RobotState:
        """The robot's state with the fields of this extension."""
        return state


MakeExtension = Callable[[ExtendedHost], HostExtension]

HOST_EXTENSIONS: Registry[MakeExtension] = Registry(
    "host extension",
    "robrain.host_extensions",
    {
        "consensus": "robrain.agent.consensus.consensus:consensus_extension",
        "witness": "robrain.agent.consensus.witness:WitnessExtension",
    },
)
"""The extensions by name, those of robrain first. One that cannot be imported is skipped."""
