"""The plugin manager: which plugins there are, who uses whom, and the start sequence (figure 3 of the paper).

Its tags are replaced, never changed in place, so that readers need no lock; loading, unloading and reloading go one at
a time, and a second one is refused while the first is under way. No lock is held while plugin code runs.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent, HostBusy, PluginError, PluginInactive, PluginInUse, PluginMissing
from robrain.agent.faults import FaultDesk
from robrain.agent.handle import Handle
from robrain.agent.loading import PluginCode
from robrain.agent.manifest import Manifest, find_manifests, read_manifest
from robrain.agent.plugin import Plugin
from robrain.agent.tag import PluginState, PluginTag
from robrain.agent.task_desk import TaskDesk
from robrain.protocol.wire.clock import Clock

logger = logging.getLogger(__name__)

MakeEnvironment = Callable[[PluginTag], Environment]


class PluginManager:
    """Holds the tags of one robot.

    Args:
        robot: its name.
        clock: the run's clock.
        desk: where behaviors register for tasks.
        make_environment: makes what a plugin is given.
        parameters: for each plugin, parameters that override its manifest's.

    """

    def __init__(
        self,
        robot: str,
        clock: Clock,
        desk: TaskDesk,
        make_environment: MakeEnvironment,
        parameters: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.robot = robot
        self.clock = clock
        self.desk = desk
        self.tags: dict[str, PluginTag] = {}
        """Requirements before those that require them."""
        self.make_environment = make_environment
        self.halted = False
        self.faults = FaultDesk(self)
        self._parameters = parameters
        self._places: list[Path] = []
        self._under_way = threading.Lock()
        self._new_faults: deque[PluginTag] = deque()

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """What the robot's own file says of a plugin's parameters."""
        return self._parameters.get(name, {})

    def construct(
        self, code: PluginCode, environment: Environment, parameters: msgspec.Struct, _manifest: Manifest
    ) -> Plugin:
        """Make the instance of a plugin."""
        return code.plugin_class(environment, parameters)

    # -- the start ------------------------------------------------------------------------------------------

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
        self._places = list(places)
        found = self._find()
        names = sorted(found) if wanted is None else list(wanted)
        tags: dict[str, PluginTag] = {}
        while names:
            name = names.pop(0)
            if name in tags:
                continue
            if name not in found:
                raise PluginMissing(name, f"no plugin {name} in any place; there are: {', '.join(sorted(found))}")
            tags[name] = tag = PluginTag(read_manifest(found[name]), self)
            if wanted is not None:
                names += [required for required in tag.manifest.tag.requires if required in found]
        self.tags = tags
        return sorted(found)

    def start(self) -> None:
        """Load and initialise each plugin, then activate each, requirements first.

        A plugin that cannot start is left out with the reason, and so is what requires it; the rest goes on.
        """
        self._sort()
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

    # -- while it runs --------------------------------------------------------------------------------------

    def load(self, name_or_path: str) -> list[PluginTag]:
        """Load and activate a plugin, with what it requires, and whatever was left out for want of these.

        Args:
            name_or_path: a name in the robot's places, or the path of a manifest or of a folder with one or more.

        Returns:
            The tags of the plugins that were loaded.

        Raises:
            PluginMissing, ManifestError, PluginError: why not; nothing is left behind then.
            HostBusy: another load, unload or reload is under way.

        """
        with self._alone():
            wanted = self._manifests_of(name_or_path)
            fresh: dict[str, PluginTag] = {}
            try:
                for manifest in wanted:
                    self._load_one(manifest, fresh)
            except BaseException:
                self._take_back(fresh)
                raise
            self._pick_up(fresh)
            return list(fresh.values())

    def unload(self, name: str, *, cascade: bool = False) -> list[str]:
        """Unload a plugin, with `cascade` also those that require it.

        Returns:
            The names of the plugins that were unloaded, in that order.

        Raises:
            PluginInUse: others require it.
            PluginMissing: there is none of that name.
            HostBusy: another load, unload or reload is under way.

        """
        with self._alone():
            tag = self.get(name)
            users = self.users_of(name)
            if users and not cascade:
                raise PluginInUse(name, [user.name for user in users])
            going = [*users, tag]
            for each in going:
                self._end(each)
            return [each.name for each in going]

    def reload(self, name: str) -> PluginTag:
        """Take a plugin's manifest and code anew from disk; if that fails the old one keeps running.

        Raises:
            PluginError: why it failed.
            HostBusy: another load, unload or reload is under way.

        """
        with self._alone():
            tag = self.get(name)
            manifest = read_manifest(tag.manifest.path)
            before = tag.state
            try:
                tag.replace(manifest)
            except PluginError:
                raise
            except Exception as error:  # foreign plugin code
                raise PluginError(name, f"{name} keeps running as it was: {type(error).__name__}: {error}") from error
            self._sort()
            if before is PluginState.FAULTED:
                self._pick_up({name: tag})
            return tag

    def settle(self, now_ns: int) -> None:
        """See to faults: their dependants, restarts, plugins that hang or flood. The host does this in its step."""
        if not self._under_way.acquire(blocking=False):
            return
        try:
            while self._new_faults:
                self.faults.note(self._new_faults.popleft(), now_ns)
            self.faults.look(now_ns)
        finally:
            self._under_way.release()

    def note_fault(self, tag: PluginTag) -> None:
        """A plugin has faulted; seen to at the next `settle`, for its users' locks must not be taken from below."""
        self._new_faults.append(tag)

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

    # -- who uses whom --------------------------------------------------------------------------------------

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

    def users_of(self, name: str) -> list[PluginTag]:
        """All that require a plugin, also by way of others; users before what they use."""
        needed = {name}
        users = []
        for tag in self.tags.values():  # requirements first
            if needed.intersection(tag.manifest.tag.requires):
                needed.add(tag.name)
                users.append(tag)
        return users[::-1]

    def excuses(self, tag: PluginTag, plugin: str) -> bool:
        """Whether it is no fault of a plugin's that one that it requires does not answer: it has gone, or is halted."""
        if self.halted:
            return True
        other = self.tags.get(plugin)
        return plugin in tag.manifest.tag.requires and (other is None or other.state is not PluginState.ACTIVE)

    # -- inside ---------------------------------------------------------------------------------------------

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if not self._under_way.acquire(blocking=False):
            raise HostBusy("", f"{self.robot} is busy with another load, unload or reload: try again")
        try:
            yield
        finally:
            self._under_way.release()

    def _find(self) -> dict[str, Path]:
        return {path.stem: path for place in self._places for path in find_manifests(place)}

    def _manifests_of(self, name_or_path: str) -> list[Manifest]:
        path = Path(name_or_path)
        if path.is_dir():
            found = find_manifests(path)
            if not found:
                raise PluginMissing(name_or_path, f"no manifest in {path}: expected a TOML file with a [plugin] table")
            return [read_manifest(each) for each in found]
        if path.suffix == ".toml" and path.is_file():
            return [read_manifest(path)]
        found_by_name = self._find()
        if name_or_path not in found_by_name:
            known = ", ".join(sorted(found_by_name))
            raise PluginMissing(
                name_or_path, f"no plugin {name_or_path} in any place, and no such folder; there are: {known}"
            )
        return [read_manifest(found_by_name[name_or_path])]

    def _load_one(self, manifest: Manifest, fresh: dict[str, PluginTag]) -> None:
        name = manifest.name
        if name in fresh:
            return
        before = self.tags.get(name)
        if before is not None and before.state is not PluginState.FAULTED:
            raise PluginError(
                name, f"{name} is loaded already, from {before.manifest.path}: reload it, or unload it first"
            )
        tag = PluginTag(manifest, self)
        fresh[name] = tag
        for required in manifest.tag.requires:
            other = self.tags.get(required)
            if required not in fresh and (other is None or other.state is PluginState.FAULTED):
                found = self._find()
                if required in found:
                    self._load_one(read_manifest(found[required]), fresh)
                else:
                    raise PluginMissing(required, f"{name} requires {required}, which is in no place")
        if before is not None:
            self.faults.forget(before)
            self._end(before)
        self._check_levels(tag)
        self.tags = {**self.tags, name: tag}
        self._sort()
        if name in self.tags and tag.state is PluginState.FAULTED:
            raise PluginError(name, f"{name}: {tag.why}")
        try:
            tag.load()
            tag.activate()
        except PluginError:
            raise
        except Exception as error:  # foreign plugin code
            raise PluginError(name, f"{name} cannot be started: {type(error).__name__}: {error}") from error

    def _check_levels(self, tag: PluginTag) -> None:
        own = tag.plugin_class
        for required in tag.manifest.tag.requires:
            other = self.get(required)
            if other.plugin_class.level >= own.level:
                raise PluginError(
                    tag.name,
                    f"{tag.name} ({own.level.name.lower()}) requires {required} "
                    f"({other.plugin_class.level.name.lower()}): merge the two, calls go to lower levels only",
                )

    def _take_back(self, fresh: dict[str, PluginTag]) -> None:
        for tag in reversed(fresh.values()):
            if tag.name in self.tags and self.tags[tag.name] is tag:
                self._end(tag)

    def _end(self, tag: PluginTag) -> None:
        try:
            if tag.state is PluginState.FAULTED:
                tag.drop()
            else:
                tag.deactivate("it is being unloaded")
        except Exception:
            # Foreign plugin code; it goes all the same.
            logger.exception("%s: plugin %s failed while it was unloaded", self.robot, tag.name)
        tag.unloaded()
        self.tags = {name: other for name, other in self.tags.items() if other is not tag}

    def _pick_up(self, fresh: dict[str, PluginTag]) -> None:
        """Start what was left out, or put aside, for want of what is there now."""
        for tag in list(self.tags.values()):
            requires = tag.manifest.tag.requires
            waits = tag.state is PluginState.INACTIVE or (tag.state is PluginState.FAULTED and not tag.is_there)
            there = all(name in self.tags and self.tags[name].state is PluginState.ACTIVE for name in requires)
            if waits and there and any(name in fresh for name in requires) and tag.name not in fresh:
                self.begin(tag)
                if tag.state is PluginState.ACTIVE:
                    fresh[tag.name] = tag

    def begin(self, tag: PluginTag) -> None:
        """Start a plugin that is listed but does not run; if that fails it is left out with the reason."""
        tag.state = PluginState.INACTIVE if tag.is_there else PluginState.DISCOVERED
        if not tag.is_there:
            self._try(tag, tag.load)
        self._try(tag, tag.activate)

    def _sort(self) -> None:
        for tag in self.tags.values():
            self._import_class(tag)
        graph = {
            name: [required for required in tag.manifest.tag.requires if required in self.tags]
            for name, tag in sorted(self.tags.items())
        }
        while True:
            try:
                order = list(TopologicalSorter(graph).static_order())
            except CycleError as error:
                cycle = error.args[1]
                path = " → ".join(reversed(cycle))
                for name in cycle:
                    self.tags[name].leave_out(f"requires itself: {path}")
                    graph[name] = []
                continue
            self.tags = {name: self.tags[name] for name in order}
            return

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
            self._leave_out(tag, f"hardware absent: {error}")
        except PluginError as error:
            logger.error("%s: plugin %s is left out: %s", self.robot, tag.name, error)  # noqa: TRY400 - said in words
            self._leave_out(tag, str(error))
        except Exception as error:  # noqa: BLE001 - foreign plugin code
            tag.fault(error)

    def _leave_out(self, tag: PluginTag, why: str) -> None:
        tag.leave_out(why)
        tag.drop()
