"""`robrain plugin check`: finds the mistakes in a folder of plugins before a robot does."""

import difflib
import dis
import inspect
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, Protocol, Union, get_args, get_origin, get_type_hints

import msgspec

from robrain.agent.class_import import module_file
from robrain.agent.errors import ManifestError
from robrain.agent.event import Event
from robrain.agent.host.agent_host import stock_place
from robrain.agent.lifecycle.access import level_refusal
from robrain.agent.lifecycle.plugin_code import PluginCode, check_parameters, import_code
from robrain.agent.lifecycle.plugin_folders import entry_point_places
from robrain.agent.lifecycle.registry import start_order
from robrain.agent.manifest import ANYBODY, COMMAND, Manifest, find_manifests, read_manifest
from robrain.agent.plugin import EXTERNAL_MARK, Plugin
from robrain.protocol.errors import BadToml
from robrain.protocol.toml_text import read_toml

POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def interface_differences(plugin_class: type[Plugin]) -> Iterator[tuple[str, str]]:
    """Members of its interface that a class lacks or defines otherwise: the name, and the problem.

    Types are compared where both sides give them; undecidable cases are not reported.
    """
    interface: object = plugin_class.interface  # whatever its author has put there
    if interface is None:
        return
    if not isinstance(interface, type):
        yield "interface", f"expected a Protocol, got {interface!r}"
        return
    hints = _hints(interface)
    for name in _promised(interface):
        promised = inspect.getattr_static(interface, name, None)
        if inspect.isfunction(promised):
            yield from ((name, what) for what in _function_differences(plugin_class, interface, name))
        elif get_origin(hints.get(name)) is Event or hints.get(name) is Event:
            if not isinstance(getattr(plugin_class, name, None), Event):
                yield name, f"{interface.__name__} has the event {name}, {plugin_class.__name__} has not"
        elif not _has(plugin_class, name):
            yield name, f"{interface.__name__} has {name}, {plugin_class.__name__} has not"


def sets_attribute(plugin_class: type, name: str) -> bool:
    """Whether a function of the class sets an attribute of that name."""
    functions = (function for _, function in inspect.getmembers(plugin_class, inspect.isfunction))
    steps = (step for function in functions for step in dis.get_instructions(function))
    return any(step.opname == "STORE_ATTR" and step.argval == name for step in steps)


def used_plugins(plugin_class: type) -> Iterator[tuple[str, str]]:
    """Each function of a class that calls `env.use` with a name that is written there, and the name."""
    for function_name, function in inspect.getmembers(plugin_class, inspect.isfunction):
        steps = list(dis.get_instructions(function))
        for step, name in pairwise(steps):
            if step.opname == "LOAD_METHOD" and step.argval == "use" and name.opname == "LOAD_CONST":
                yield function_name, name.argval


def _promised(interface: type) -> list[str]:
    bases = [base for base in interface.__mro__ if base not in (object, Protocol, Generic)]
    names = (name for base in bases for name in (*vars(base), *vars(base).get("__annotations__", ())))
    return sorted({name for name in names if not name.startswith("_")})


def _has(plugin_class: type, name: str) -> bool:
    declared = any(name in vars(base).get("__annotations__", ()) for base in plugin_class.__mro__)
    return declared or hasattr(plugin_class, name) or sets_attribute(plugin_class, name)


def _function_differences(plugin_class: type, interface: type, name: str) -> Iterator[str]:
    own = getattr(plugin_class, name, None)
    if not callable(own):
        yield f"{interface.__name__} has the function {name}, {plugin_class.__name__} has not"
        return
    try:
        own_signature, wanted = _signature(plugin_class, name), _signature(interface, name)
    except (TypeError, ValueError):  # Python has no signature of functions written in C
        return
    if not _fits(own_signature, wanted):
        yield (
            f"{plugin_class.__name__}.{name}{own_signature} cannot be called as "
            f"{interface.__name__}.{name}{wanted} promises"
        )
        return
    own_hints, wanted_hints = _hints(own), _hints(getattr(interface, name))
    for parameter in own_signature.parameters.keys() & wanted.parameters.keys():
        promised, accepted = wanted_hints.get(parameter, Any), own_hints.get(parameter, Any)
        if not _accepts(accepted, promised):
            yield f"takes {_word(accepted)} for {parameter}, {interface.__name__} promises to take {_word(promised)}"
    promised, returned = wanted_hints.get("return", Any), own_hints.get("return", Any)
    if promised is not NoneType and not _accepts(promised, returned):
        yield f"returns {_word(returned)}, {interface.__name__} promises {_word(promised)}"


def _signature(owner: type, name: str) -> inspect.Signature:
    """The signature for a caller, without hints; differences between hints are checked elsewhere."""
    signature = inspect.signature(getattr(owner, name))
    parameters = list(signature.parameters.values())
    if inspect.isfunction(inspect.getattr_static(owner, name)):
        parameters = parameters[1:]
    return signature.replace(
        parameters=[parameter.replace(annotation=inspect.Parameter.empty) for parameter in parameters],
        return_annotation=inspect.Signature.empty,
    )


def _fits(own: inspect.Signature, wanted: inspect.Signature) -> bool:
    """Whether each call that `wanted` allows reaches the same parameters of `own`."""
    parameters = wanted.parameters.values()
    required = [parameter for parameter in parameters if parameter.default is inspect.Parameter.empty]
    try:
        for called in (list(parameters), [each for each in required if each.kind in (*POSITIONAL, *BY_NAME)]):
            by_place = [each.name for each in called if each.kind in POSITIONAL]
            by_name = {each.name: each.name for each in called if each.kind is inspect.Parameter.KEYWORD_ONLY}
            reached = own.bind(*by_place, **by_name).arguments
            if any(value != name for name, value in reached.items() if name in by_place):
                return False
            only_place = [each.name for each in called if each.kind is inspect.Parameter.POSITIONAL_ONLY]
            own.bind(*only_place, **{each.name: each.name for each in called if each.kind in BY_NAME})
    except TypeError:
        return False
    return True


def _hints(of: Callable[..., Any] | type) -> dict[str, Any]:
    try:
        return get_type_hints(of)
    except Exception:  # noqa: BLE001 - hints are foreign code, and may name types imported only for type checkers
        return {}


def _accepts(wide: Any, narrow: Any) -> bool:
    """Whether a value of type `narrow` is one of type `wide`; True where that cannot be decided."""
    if wide == narrow or Any in (wide, narrow) or (wide, narrow) in ((float, int), (complex, float), (complex, int)):
        return True
    if get_origin(narrow) in (Union, UnionType):
        return all(_accepts(wide, part) for part in get_args(narrow))
    if get_origin(wide) in (Union, UnionType):
        return any(_accepts(part, narrow) for part in get_args(wide))
    outer, inner = get_origin(wide) or wide, get_origin(narrow) or narrow
    if not (isinstance(outer, type) and isinstance(inner, type)):
        return True
    try:
        if not issubclass(inner, outer):
            return False
    except TypeError:  # a Protocol with attributes
        return True
    pairs = zip(get_args(wide), get_args(narrow), strict=False) if outer is inner else ()
    return all(_accepts(*pair) for pair in pairs)


def _word(kind: Any) -> str:
    return kind.__name__ if isinstance(kind, type) and not get_args(kind) else str(kind)


class PluginFinding(msgspec.Struct, frozen=True):
    """One mistake, or something that is worth a look."""

    path: Path
    """The file that it is in."""
    key: str
    """The manifest's key, or the class's function."""
    message: str
    is_warning: bool = False
    """A robot would load the plugin nevertheless."""

    def __str__(self) -> str:
        return f"{self.path}: {self.key}: {'warning: ' if self.is_warning else ''}{self.message}"


def check_plugins(folder: Path) -> list[PluginFinding]:
    """The mistakes in the plugins of a folder, in the order of their files.

    The plugins are imported, but not created. Required plugins are searched in the folder, among the stock plugins and
    in installed distributions.
    """
    return _Check(folder).findings()


class _Check:
    """One look at a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._own: dict[str, Manifest] = {}
        """The folder's manifests, by name."""
        self._all: dict[str, Manifest] = {}
        """These, and those that come with robrain or are installed."""
        self._roles: set[str] = set()
        """Names and roles of plugins of robrain and of installed distributions."""
        self._codes: dict[Path, PluginCode | None] = {}
        self._modules: set[tuple[Path, str]] = set()

    def findings(self) -> list[PluginFinding]:
        """All that is found, once each."""
        found = [*self._read(), *self._check(), *self._cycles()]
        return sorted(dict.fromkeys(found), key=lambda finding: finding.path)

    def _read(self) -> Iterator[PluginFinding]:
        for place in (stock_place(), *(place for place, _ in entry_point_places())):
            for path in find_manifests(place):
                try:
                    self._all[path.stem] = read_manifest(path)
                except ManifestError:
                    continue  # a mistake of another plugin
        self._roles = {manifest.name for manifest in self._all.values()}
        others = dict(self._all)
        for path in find_manifests(self._folder):
            try:
                manifest = read_manifest(path)
            except ManifestError as error:
                yield _of_manifest(error)
                continue
            if path.stem in self._own:
                yield PluginFinding(path, "file name", f"{self._own[path.stem].path} has the same: only one is loaded")
            elif path.stem in others and others[path.stem].path.resolve() != path.resolve():
                other = others[path.stem].path
                yield PluginFinding(path, "file name", f"takes the place of {path.stem} in {other}", is_warning=True)
            self._own[path.stem] = self._all[path.stem] = manifest
        yield from self._without_plugin_table()
        if not find_manifests(self._folder):
            yield PluginFinding(self._folder, "folder", "no manifest in it: expected a TOML file with a [plugin] table")

    def _without_plugin_table(self) -> Iterator[PluginFinding]:
        for path in sorted(set(self._folder.rglob("*.toml")) - set(find_manifests(self._folder))):
            try:
                tables = read_toml(path)
            except BadToml:
                continue  # data too large for a manifest, or a dangling link
            if "tag" in tables or path.with_suffix(".py").is_file():
                yield PluginFinding(path, "file", "expected a table [plugin]; without one it is passed over")

    def _check(self) -> Iterator[PluginFinding]:
        for manifest in self._own.values():
            try:
                code = self._import(manifest)
            except ManifestError as error:
                yield _of_manifest(error)
            else:
                yield from _parameters(manifest, code)
                yield from _class(code.plugin_class)
                yield from _external(code.plugin_class)
                yield from _used(manifest, code.plugin_class)
            yield from self._role(manifest)
            yield from self._visibility(manifest)
            for required in manifest.tag.requires:
                yield from self._requirement(manifest, required)

    def _import(self, manifest: Manifest) -> PluginCode:
        module = (manifest.path.parent, manifest.module_name)
        # Read again, for it may have been edited since; but once, for its classes share the interfaces in it.
        is_fresh = module_file(manifest) is not None and module not in self._modules
        self._modules.add(module)
        self._codes[manifest.path] = None
        try:
            code = self._codes[manifest.path] = import_code(manifest, fresh=is_fresh)
        except ManifestError as error:
            raise _with_line(error, self._folder) from error
        return code

    def _code(self, manifest: Manifest) -> PluginCode | None:
        """Code of a plugin; None if it cannot be imported."""
        if manifest.path not in self._codes:
            with suppress(ManifestError):  # reported with that plugin itself
                self._import(manifest)
        return self._codes[manifest.path]

    def _role(self, manifest: Manifest) -> Iterator[PluginFinding]:
        if manifest.name not in self._roles and manifest.name not in self._all:
            reason = f"there is no plugin {manifest.name} whose place it could take{self._meant(manifest.name)}"
            yield PluginFinding(manifest.path, "[plugin] role", reason)

    def _visibility(self, manifest: Manifest) -> Iterator[PluginFinding]:
        for name in manifest.tag.visibility:
            if name not in (ANYBODY, COMMAND) and name not in self._all:
                yield PluginFinding(manifest.path, "[tag] visibility", f"there is no plugin {name}{self._meant(name)}")

    def _requirement(self, manifest: Manifest, required: str) -> Iterator[PluginFinding]:
        key = "[tag] requires"
        if required not in self._all:
            yield PluginFinding(manifest.path, key, f"nobody provides {required}{self._meant(required)}")
            return
        other = self._all[required]
        if manifest.name not in other.tag.visibility and ANYBODY not in other.tag.visibility:
            yield PluginFinding(
                manifest.path, key, f"{manifest.name} is not in the visibility of {required}: add it in {other.path}"
            )
        # Of two plugins for one role, only one is loaded.
        rivals = [each.name for each in self._all.values() if required in each.tag.requires]
        rivals = [name for name in dict.fromkeys(rivals) if name != manifest.name]
        if not other.tag.shared and rivals:
            held = f"{required} is not shared, and {', '.join(rivals)} may hold it"
            yield PluginFinding(manifest.path, key, held, is_warning=True)
        own_code, code = self._code(manifest), self._code(other)
        if own_code is None or code is None or required == manifest.name:
            return
        own_level, level = own_code.plugin_class.level, code.plugin_class.level
        if level >= own_level:
            yield PluginFinding(
                manifest.path,
                key,
                level_refusal(manifest.name, own_level, required, level),
            )
        elif code.plugin_class.interface is None:
            yield PluginFinding(manifest.path, key, f"{required} has no interface to call it by", is_warning=True)

    def _cycles(self) -> Iterator[PluginFinding]:
        _, circles = start_order({name: manifest.tag.requires for name, manifest in self._all.items()})
        for _, *circle in circles:
            first = next((index for index, name in enumerate(circle) if name in self._own), None)
            if first is not None:
                names = [*circle[first:], *circle[: first + 1]]
                reason = f"{names[0]} requires itself: {' → '.join(names)}"
                yield PluginFinding(self._own[names[0]].path, "[tag] requires", reason)

    def _meant(self, name: str) -> str:
        near = difflib.get_close_matches(name, self._all, n=1)
        return f"; is {near[0]} meant?" if near else f"; there are: {', '.join(sorted(self._all))}"


def _of_manifest(error: ManifestError) -> PluginFinding:
    return PluginFinding(error.path, error.key, str(error).removeprefix(f"{error.path}: {error.key}: "))


def _with_line(error: ManifestError, folder: Path) -> ManifestError:
    """The same, with the line in the folder's own code at which an import failed."""
    cause = error.__cause__
    frames = traceback.extract_tb(cause.__traceback__) if cause is not None else []
    own = [frame for frame in frames if Path(frame.filename).resolve().is_relative_to(folder.resolve())]
    what = _of_manifest(error).message
    if not own:
        return error
    return ManifestError(error.path, error.key, f"{what} ({Path(own[-1].filename).name}, line {own[-1].lineno})")


def _parameters(manifest: Manifest, code: PluginCode) -> Iterator[PluginFinding]:
    kind = code.plugin_class.Parameters
    try:
        fields = msgspec.structs.fields(kind)
    except TypeError:
        yield PluginFinding(_source(code.plugin_class), f"{code.plugin_class.__name__}.Parameters", "expected a struct")
        return
    missing = [each.encode_name for each in fields if each.required and each.encode_name not in manifest.parameters]
    if missing:
        for name in missing:
            expected = "no value and no default: each robot's file must set it"
            yield PluginFinding(manifest.path, f"[parameters] {name}", expected, is_warning=True)
        return
    try:
        check_parameters(manifest, code, {})
    except ManifestError as error:
        yield _of_manifest(error)
    except Exception as error:  # noqa: BLE001 - the struct's own checks are foreign plugin code
        yield PluginFinding(manifest.path, "[parameters]", f"{type(error).__name__}: {error}")


def _class(plugin_class: type[Plugin]) -> Iterator[PluginFinding]:
    path, name = _source(plugin_class), plugin_class.__name__
    if not inspect.cleandoc(plugin_class.__doc__ or ""):
        yield PluginFinding(path, name, "no docstring: expected a line on what the plugin does", is_warning=True)
    period_s: object = plugin_class.period_s
    if period_s is not None and not (isinstance(period_s, (int, float)) and period_s > 0):
        yield PluginFinding(
            path, f"{name}.period_s", f"expected a number of seconds above 0, or None, got {period_s!r}"
        )
    has_step = plugin_class.step is not Plugin.step
    if has_step and period_s is None and not sets_attribute(plugin_class, "period_s"):
        yield PluginFinding(path, f"{name}.step", "is never called: the class has no period_s", is_warning=True)
    if period_s is not None and not has_step:
        yield PluginFinding(path, f"{name}.period_s", "there is no step to call so often", is_warning=True)
    for function, what in interface_differences(plugin_class):
        yield PluginFinding(path, f"{name}.{function}", what)


def _external(plugin_class: type[Plugin]) -> Iterator[PluginFinding]:
    path = _source(plugin_class)
    for name, function in inspect.getmembers(plugin_class, inspect.isfunction):
        if not getattr(function, EXTERNAL_MARK, None):
            continue
        key = f"{plugin_class.__name__}.{name}"
        if not inspect.getdoc(function):
            yield PluginFinding(path, key, "no docstring: expected a line for whoever calls it", is_warning=True)
        bare = [
            each for each in list(inspect.signature(function).parameters)[1:] if each not in function.__annotations__
        ]
        if bare:
            text = f"no type hint for {', '.join(bare)}: anything is accepted"
            yield PluginFinding(path, key, text, is_warning=True)


def _used(manifest: Manifest, plugin_class: type[Plugin]) -> Iterator[PluginFinding]:
    for function, used in used_plugins(plugin_class):
        if used not in manifest.tag.requires:
            what = f"uses {used}: name it in [tag] requires of {manifest.path.name}"
            yield PluginFinding(_source(plugin_class), f"{plugin_class.__name__}.{function}", what)


def _source(plugin_class: type[Plugin]) -> Path:
    return Path(inspect.getfile(plugin_class))
