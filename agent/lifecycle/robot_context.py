"""What a plugin needs of its robot."""

from collections.abc import Mapping
from typing import Any, Protocol

from robrain.agent.access.callee import Callee, Caller
from robrain.agent.access.exclusive_use import ExternalLeases
from robrain.agent.environment import Environment, PluginRequests
from robrain.agent.task_desk import TaskDesk
from robrain.protocol.clock import Clock


class RobotContext(Protocol):
    """What a plugin needs of its robot."""

    robot: str
    clock: Clock
    desk: TaskDesk
    leases: ExternalLeases
    halted: bool
    has_one_thread: bool
    """Whether nothing but the lockstep runner's own thread ever calls a plugin."""

    @property
    def is_live(self) -> bool:
        """Whether the drive is live."""

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """What the robot's own file says of a plugin's parameters."""

    def make_environment(self, plugin: PluginRequests) -> Environment:
        """An environment for a new instance, with an endpoint of its own."""

    def request(self, caller: Caller, name: str, interface: type) -> Any:
        """A handle on another plugin, or an error that says why not."""

    def release(self, name: str) -> None:
        """A plugin holds no other any more."""

    newly_running: bool
    """Whether a plugin runs that did not; the host resets it when it has started the plugins that lacked one."""

    def record_fault(self, plugin: Any) -> None:
        """A plugin has faulted; to be seen to in the host's own step."""

    def excuses(self, plugin: Callee, error: BaseException) -> bool:
        """Whether an error that a plugin raised is the fault of another plugin, or of a halt."""
