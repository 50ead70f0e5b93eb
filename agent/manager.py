"""The plugin manager: which plugins there are, who uses whom, and the start sequence (figure 3 of the paper)."""

import logging
from collections.abc import Callable, Iterable, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent, PluginError, PluginInactive, PluginMissing
from robrain.agent.handle import Handle
from robrain.agent.manifest import find_manifests, read_manifest
from robrain.agent.tag import PluginState, PluginTag

logger = logging.getLogger(__name__)

MakeEnvironment = Callable[[PluginTag], Environment]


class PluginManager:
    """Holds the tags of one robot.

    Args:
        robot: its name.
        make_environment: makes what a plugin is given.
        parameters: for each plugin, parameters that override its manifest's.

    """

    def __init__(
        self, robot: str, make_environment: MakeEnvironment, parameters: Mapping[str, Mapping[str, Any]]
    ) -> None:
        self.robot = robot
        self.tags: dict[str, PluginTag] = {}
        """In start order once started."""
        self.make_environment = make_environment
        self.halted = False
        self._parameters = parameters

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """What the robot's own file says of a plugin's parameters."""
        return self._parameters.get(name, {})

    def discover(self, places: Iterable[Path], wanted: list[str] | None = None) -> list[str]:
        """Make a tag for each manifest in the places; of two with one name the later place wins.

        Args:
            places: folders.
            wanted: names to take; all if None. What these require is taken as well.

        Returns:
            The names of all plugins that were found.

        Raises:
            ManifestError: a manifest is wrong.
            PluginMissing: a wanted plugin is in no place.

        """
        found = {}
        for place in places:
            for path in find_manifests(place):
                found[path.stem] = path
        names = sorted(found) if wanted is None else list(wanted)
        while names:
            name = names.pop(0)
            if name in self.tags:
                continue
            if name not in found:
                raise PluginMissing(name, f"no plugin {name} in any place; there are: {', '.join(sorted(found))}")
            self.tags[name] = tag = PluginTag(read_manifest(found[name]), self)
            if wanted is not None:
                names += [required for required in tag.manifest.tag.requires if required in found]
        return sorted(found)

    def start(self) -> None:
        """Load and initialise each plugin, then activate each, requirements first.

        A plugin that cannot start is left out with the reason, and so is what requires it; the rest goes on.
        """
        self.tags = {name: self.tags[name] for name in self._start_order()}
        for tag in self.tags.values():
            self._try(tag, tag.load)
        for tag in self.tags.values():
            self._try(tag, tag.activate)

    def stop(self) -> None:
        """Deactivate all, users before what they use, and close what they held."""
        for tag in reversed(self.tags.values()):
            try:
                tag.deactivate()
            except Exception as error:
                # Foreign plugin code; the others must be stopped all the same. In a halted robot plugins refuse each
                # other, which is as it should be.
                if not (isinstance(error, PluginInactive) and self.halted):
                    logger.exception("%s: plugin %s failed while it was stopped", self.robot, tag.name)
        for tag in self.tags.values():
            tag.close()

    def get(self, name: str) -> PluginTag:
        """The tag of a plugin (PluginMissing if there is none)."""
        try:
            return self.tags[name]
        except KeyError:
            raise PluginMissing(name, f"no plugin {name}; there are: {', '.join(self.tags)}") from None

    def request(self, caller: PluginTag, name: str, interface: type) -> Handle:
        """Pass a plugin's request for another on to the other's tag."""
        return self.get(name).grant(caller, interface)

    def release(self, name: str) -> None:
        """A plugin goes: nothing is held by it any more."""
        for tag in self.tags.values():
            if tag.holder == name:
                tag.holder = ""

    def halt(self) -> None:
        """Emergency halt: all calls are refused, then devices stop, then upwards. Latches until `resume`."""
        self.halted = True
        for tag in self.tags.values():
            tag.refuse_calls()
        for tag in sorted(self.tags.values(), key=lambda tag: tag.level):
            try:
                tag.halt()
            except Exception:
                # Foreign plugin code; the others must be halted all the same.
                logger.exception("%s: plugin %s failed while it was halted", self.robot, tag.name)

    def resume(self) -> None:
        """End an emergency halt."""
        self.halted = False
        for tag in self.tags.values():
            tag.resume()

    def _start_order(self) -> list[str]:
        for name in list(self.tags):
            self._import_class(self.tags[name])
        graph = {
            name: [required for required in tag.manifest.tag.requires if required in self.tags]
            for name, tag in sorted(self.tags.items())
        }
        while True:
            try:
                return list(TopologicalSorter(graph).static_order())
            except CycleError as error:
                cycle = error.args[1]
                path = " → ".join(reversed(cycle))
                for name in cycle:
                    self.tags[name].leave_out(f"requires itself: {path}")
                    graph[name] = []

    def _import_class(self, tag: PluginTag) -> None:
        try:
            _ = tag.plugin_class
        except PluginError as error:
            tag.leave_out(str(error))
            logger.error("%s: plugin %s is left out: %s", self.robot, tag.name, error)  # noqa: TRY400 - said in words

    def _try(self, tag: PluginTag, do: Callable[[], None]) -> None:
        if tag.state is PluginState.FAULTED:
            return
        try:
            for required in tag.manifest.tag.requires:
                other = self.get(required)
                if other.state is PluginState.FAULTED:
                    raise PluginError(tag.name, f"requires {required}, which is left out: {other.why}")
            do()
        except HardwareAbsent as error:
            logger.warning("%s: plugin %s is left out: %s", self.robot, tag.name, error)
            tag.leave_out(f"hardware absent: {error}")
        except PluginError as error:
            logger.error("%s: plugin %s is left out: %s", self.robot, tag.name, error)  # noqa: TRY400 - said in words
            tag.leave_out(str(error))
        except Exception as error:  # noqa: BLE001 - foreign plugin code
            tag.fault(error)
