"""The plugin manager: which plugins there are, who uses whom, and the start sequence (figure 3 of the paper).

Its tags are replaced, never changed in place, so that readers need no lock; loading, unloading and reloading go one at
a time, and a second one is refused while the first is under way. No lock is held while plugin code runs.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from robrain.agent.access import must_merge
from robrain.agent.crew import Crew
from robrain.agent.environment import Environment
from robrain.agent.errors import (
    FOREIGN_ERRORS,
    HostBusy,
    PluginError,
    PluginInactive,
    PluginInUse,
    PluginMissing,
    short_path,
)
from robrain.agent.faults import FaultDesk
from robrain.agent.foreign import ForeignPlugins
from robrain.agent.halt_order import halt_plugins
from robrain.agent.handle import Handle
from robrain.agent.leases import ExternalLeases
from robrain.agent.manifest import Manifest, read_manifest
from robrain.agent.places import Places
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_state import PluginState
from robrain.agent.requirements import branch_of
from robrain.agent.starter import Starter
from robrain.agent.tag import PluginTag
from robrain.agent.task_desk import TaskDesk
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages import PluginInfo

logger = logging.getLogger(__name__)

MakeEnvironment = Callable[[PluginTag], Environment]

LOOK_TIMEOUT_S = 10.0
"""How long, in live, a load waits for the host's own look at faults, which is mostly over at once."""


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
        self.foreign: ForeignPlugins | None = None
        """Plugins that are processes of their own, in live."""
        self.crew: Crew | None = None
        """Starts plugins, in live; one that hangs while it is started is left behind."""
        self.leases = ExternalLeases(clock)
        self._starter = Starter(self)
        self._parameters = parameters
        self._places = Places([])
        self._changing = threading.Lock()
        """Held by a load, unload, reload or restart."""
        self._under_way = threading.Lock()
        """Held by these as well, and by `settle`."""
        self._stopped = False
        self._new_faults: deque[PluginTag] = deque()

    @property
    def is_live(self) -> bool:
        """Whether the drive is live. Time limits on plugins, which run on the wall clock, apply only then."""
        return self.crew is not None

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """What the robot's own file says of a plugin's parameters."""
        return self._parameters.get(name, {})

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
        self._places = Places(places)
        found = self._places.find()
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
        self._starter.start_all()

    def stop(self) -> None:
        """Deactivate all, users before what they use, and close what they held."""
        self._stopped = True
        for tag in reversed(self.tags.values()):
            try:
                tag.deactivate()
            except FOREIGN_ERRORS as error:
                # Foreign plugin code; the others must be stopped all the same. In a halted robot plugins refuse each
                # other, which is as it should be.
                if not (isinstance(error, PluginInactive) and self.halted):
                    logger.exception("%s: plugin %s failed while it was stopped", self.robot, tag.name)
        for tag in self.tags.values():
            tag.close()

    # -- while it runs --------------------------------------------------------------------------------------

    def load(self, name_or_path: str, within: Iterable[Path] | None = None) -> list[PluginTag]:
        """Load and activate a plugin, with what it requires, and whatever was left out for want of these.

        Args:
            name_or_path: a name in the robot's places, or the path of a manifest or of a folder with one or more.
            within: folders, besides the places, that a path must lie in; None allows any path and is only for callers
                in this process.

        Returns:
            The tags of the plugins that were loaded.

        Raises:
            AccessDenied: the path is outside all of these folders.
            PluginMissing, ManifestError, PluginError: loading failed; nothing stays loaded then.
            HostBusy: another load, unload or reload is under way.

        """
        with self._alone():
            wanted = {manifest.name: manifest for manifest in self._places.manifests_of(name_or_path, within)}
            fresh: dict[str, PluginTag] = {}
            before = self.tags
            try:
                for manifest in wanted.values():
                    self._load_one(manifest, fresh, wanted, ())
            except BaseException:
                self._take_back(fresh, before)
                raise
            for name in fresh.keys() & before.keys():
                self.faults.forget(before[name])
                before[name].unloaded()
            self._starter.pick_up(fresh)
            return list(fresh.values())

    def unload(self, name: str, *, cascade: bool = False) -> list[PluginTag]:
        """Unload a plugin, with `cascade` also those that require it.

        Returns:
            The tags of the plugins that were unloaded, in that order.

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
            return going

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
                self._starter.in_time(tag, partial(tag.replace, manifest))
            except PluginError:
                raise
            except FOREIGN_ERRORS as error:  # foreign plugin code
                raise PluginError(name, f"{name} keeps running as it was: {type(error).__name__}: {error}") from error
            self._starter.sort()
            if before not in (PluginState.ACTIVE, PluginState.HALTED):
                self.faults.forget(tag)
                self._starter.pick_up({name: tag})
            return tag

    def settle(self, now_ns: int) -> None:
        """See to faults: their dependants, restarts, plugins that hang or flood. The host does this in its step."""
        if not self._under_way.acquire(blocking=False):
            return
        try:
            self._see_to_faults(now_ns)
            self.faults.look(now_ns)
        finally:
            self._under_way.release()

    def begin(self, tag: PluginTag) -> None:
        """Start a plugin that is listed but does not run; if that fails it is left out with the reason."""
        self._starter.begin(tag)

    def note_fault(self, tag: PluginTag) -> None:
        """A plugin has faulted; seen to at the next `settle`, for its users' locks must not be taken from below."""
        if tag not in self._new_faults:
            self._new_faults.append(tag)

    def later(self, do: Callable[[], None]) -> None:
        """Have something done alone that may take its time; in live not on the host's own thread."""
        if self.crew is None:
            do()
        else:
            self.crew.begin(partial(self._do_alone, do))

    def halt(self, crew: Crew | None = None) -> list[str]:
        """Emergency halt; latches until `resume`. The names of plugins that did not stop; see `halt_plugins`."""
        self.halted = True
        return halt_plugins(self.robot, list(self.tags.values()), crew)

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
        """Pass a plugin's request for another on to the other's tag, or to a foreign process of that name."""
        if self.foreign is not None and self.is_foreign(name):
            return self.foreign.use(caller.name, caller.level, name, interface)
        return self.get(name).grant(caller, interface)

    def is_foreign(self, name: str) -> bool:
        """Whether it is a process of its own that goes by this name."""
        return self.foreign is not None and name not in self.tags and name in self.foreign

    def foreign_infos(self) -> list[PluginInfo]:
        """Those plugins that are processes of their own; the robot's own come first where names are the same."""
        return [info for info in self.foreign.infos() if info.name not in self.tags] if self.foreign else []

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
        return plugin in branch_of(tag.name, self.requirements()) and (
            other is None or other.state is not PluginState.ACTIVE
        )

    def open_wire(self, tag: PluginTag) -> Endpoint:
        """A place on the wire for one activation of a plugin."""
        return self.make_environment(tag).wire

    def check_heir(self, manifest: Manifest, plugin_class: type[Plugin]) -> None:
        """Whether a plugin, edited, still fits in with what it requires, and with those that require it.

        Raises:
            PluginError: a level speaks against it, or what it requires does not run.

        """
        self._check_branch(manifest, plugin_class)
        for user in self.tags.values():
            if manifest.name in user.manifest.tag.requires and user.plugin_class.level <= plugin_class.level:
                raise must_merge(user.name, user.plugin_class, manifest.name, plugin_class)

    # -- inside ---------------------------------------------------------------------------------------------

    @contextmanager
    def _alone(self) -> Iterator[None]:
        busy = HostBusy("", f"{self.robot} is busy with another load, unload or reload: try again")
        if not self._changing.acquire(blocking=False):
            raise busy
        try:
            # In lockstep it is this thread that settles, and then waiting would not help.
            if not self._under_way.acquire(timeout=LOOK_TIMEOUT_S if self.is_live else 0.0):
                raise busy
            try:
                self._see_to_faults(self.clock.now_ns())
                yield
            finally:
                self._under_way.release()
        finally:
            self._changing.release()

    def _do_alone(self, do: Callable[[], None]) -> None:
        with self._changing, self._under_way:
            if not self._stopped:
                do()

    def _see_to_faults(self, now_ns: int) -> None:
        while self._new_faults:
            self.faults.note(self._new_faults.popleft(), now_ns)

    def _load_one(
        self, manifest: Manifest, fresh: dict[str, PluginTag], wanted: dict[str, Manifest], users: tuple[str, ...]
    ) -> None:
        name = manifest.name
        if name in fresh:
            return
        path = (*users, name)
        if name in users:
            raise PluginError(users[0], f"{name} requires itself: {' → '.join(path[users.index(name) :])}")
        before = self.tags.get(name)
        if before is not None and before.state is not PluginState.FAULTED:
            raise PluginError(
                name,
                f"{name} is loaded already, from {short_path(before.manifest.path)}: reload it, or unload it first",
            )
        tag = PluginTag(manifest, self)
        for required in manifest.tag.requires:
            other = self.tags.get(required)
            if (other is None or other.state is PluginState.FAULTED) and not self.is_foreign(required):
                there = wanted.get(required) or self._places.read(required)
                if there is None:
                    way = " → ".join([*path, required])
                    raise PluginMissing(required, f"{name} requires {required}, which is in no place ({way})")
                self._load_one(there, fresh, wanted, path)
        self._check_branch(manifest, tag.plugin_class)
        fresh[name] = tag
        self.tags = {**self.tags, name: tag}
        self._starter.sort()
        if name in self.tags and tag.state is PluginState.FAULTED:
            raise PluginError(name, f"{name}: {tag.why}")
        try:
            self._starter.in_time(tag, tag.load)
            self._starter.in_time(tag, tag.activate)
        except PluginError:
            raise
        except FOREIGN_ERRORS as error:  # foreign plugin code
            raise PluginError(name, f"{name} cannot be started: {type(error).__name__}: {error}") from error

    def _check_branch(self, manifest: Manifest, plugin_class: type[Plugin]) -> None:
        for required in manifest.tag.requires:
            if self.is_foreign(required):
                continue
            other = self.get(required)
            if other.plugin_class.level >= plugin_class.level:
                raise must_merge(manifest.name, plugin_class, required, other.plugin_class)
            if other.state not in (PluginState.ACTIVE, PluginState.HALTED):
                raise PluginError(
                    manifest.name, f"{manifest.name} requires {required}, which is {other.state}: {other.why}"
                )

    def requirements(self) -> dict[str, list[str]]:
        """What each plugin requires, by name."""
        return {name: tag.manifest.tag.requires for name, tag in self.tags.items()}

    def _is_there(self, name: str) -> bool:
        return name in self.tags or self.is_foreign(name)

    def _take_back(self, fresh: dict[str, PluginTag], before: dict[str, PluginTag]) -> None:
        for tag in reversed(fresh.values()):
            self._end(tag)
        self.tags = before

    def _end(self, tag: PluginTag) -> None:
        self.faults.forget(tag)
        try:
            if tag.state in (PluginState.ACTIVE, PluginState.HALTED):
                tag.deactivate("it is being unloaded")
            elif tag.state is not PluginState.INACTIVE:
                tag.drop()
        except FOREIGN_ERRORS:
            # Foreign plugin code; it goes all the same.
            logger.exception("%s: plugin %s failed while it was unloaded", self.robot, tag.name)
        tag.unloaded()
        self.tags = {name: other for name, other in self.tags.items() if other is not tag}

    def came(self, foreign: Iterable[str]) -> None:
        """Foreign plugins have come: start what was left out for want of them."""
        names = dict.fromkeys(foreign)
        if any(name in names for tag in self.tags.values() for name in tag.manifest.tag.requires):
            self.later(partial(self._starter.pick_up, names))
