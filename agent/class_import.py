"""Importing a plugin's class from the module that its manifest names; modules are executed again after an edit.

The folder of a manifest is imported as a package, so that a plugin may have several files.
"""

import builtins
import hashlib
import importlib
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, FileFinder, ModuleSpec, SourceFileLoader
from importlib.util import find_spec, module_from_spec, spec_from_file_location, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

from robrain.agent.errors import ManifestError, PackageMissing
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin
from robrain.protocol.extras import missing_package

SOURCE_MARK = "__robrain_source__"
"""In a module: the bytes that it was read from, so that a later load sees whether they were edited."""
PREFIX = "robrain_plugin_"
"""Begin of the names under which the folders of plugins are imported."""


def module_file(manifest: Manifest) -> Path | None:
    """The module's file beside the manifest; None if the module is imported by its name."""
    beside = manifest.path.parent / f"{manifest.module_name}.py"
    return beside if beside.is_file() else None


def import_class(manifest: Manifest, *, fresh: bool = False) -> type[Plugin]:
    """Import the class that a manifest names.

    Args:
        manifest: its `class` is `module:Class`; the module lies beside the manifest or can be imported.
        fresh: execute the module again, after an edit; if that fails the old module stays.

    Raises:
        PackageMissing: it needs an extra that is not installed.
        ManifestError: it cannot be imported for another reason, or is no plugin.

    """
    name, file = manifest.module_name, module_file(manifest)
    try:
        module = import_file(file, fresh=fresh) if file is not None else _import_module(name, fresh=fresh)
    except SystemExit as error:
        raise ManifestError(manifest.path, "[plugin] class", f"cannot import {name}: it calls exit()") from error
    except Exception as error:  # foreign code may raise anything while it is imported
        missing = missing_package(error) if isinstance(error, ImportError) else None
        if missing is not None and missing.extra:
            raise PackageMissing(manifest.path, name, missing) from error
        raise ManifestError(manifest.path, "[plugin] class", f"cannot import {name}: {error}") from error
    class_name = manifest.class_path.partition(":")[2]
    found = getattr(module, class_name, None)
    if not (isinstance(found, type) and issubclass(found, Plugin) and hasattr(found, "level")):
        raise ManifestError(
            manifest.path, "[plugin] class", f"expected a Device, Unit, Skill or Behavior named {class_name} in {name}"
        )
    return found


def import_file(path: Path, *, fresh: bool = False) -> ModuleType:
    """Import a file as a module of its folder; all modules of the folder again if one of them was edited.

    Args:
        path: the file.
        fresh: execute the file again in any case.

    Raises:
        Exception: the error that the file raised; all modules stay as they were.

    """
    folder = str(path.resolve().parent)
    package = PREFIX + hashlib.md5(folder.encode(), usedforsecurity=False).hexdigest()[:12]
    _FINDER.folders[package] = folder
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
    name, before = f"{package}.{path.stem}", _modules_of(package)
    if any(map(_was_edited, before.values())):
        replaced = before
    else:
        replaced = {name: before[name]} if fresh and name in before else {}
    for each in replaced:
        del sys.modules[each]
    try:
        return importlib.import_module(name)
    except BaseException:
        for each in _modules_of(package):
            if each not in before or each in replaced:
                del sys.modules[each]
        sys.modules.update(replaced)
        raise


def _import_module(name: str, *, fresh: bool) -> ModuleType:
    module = importlib.import_module(name)
    if not fresh or module.__spec__ is None or module.__spec__.origin is None:
        return module
    loader = _Loader(name, module.__spec__.origin)
    spec = spec_from_loader(name, loader)
    assert spec is not None
    again = sys.modules[name] = module_from_spec(spec)
    try:
        loader.exec_module(again)
    except BaseException:
        sys.modules[name] = module
        raise
    return again


def _modules_of(package: str) -> dict[str, ModuleType]:
    return {name: module for name, module in sys.modules.items() if f"{name}.".startswith(f"{package}.")}


def _was_edited(module: ModuleType) -> bool:
    source = module.__dict__.get(SOURCE_MARK)
    try:
        return source is not None and Path(str(module.__file__)).read_bytes() != source
    except OSError:
        return True


class _Loader(SourceFileLoader):
    """Executes a file as it is now, and has modules of a plugin's folder find each other."""

    def path_stats(self, path: str) -> Mapping[str, Any]:
        """Keep no byte code: Python compares whole seconds of the time stamp and would miss a quick edit."""
        raise OSError

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module."""
        setattr(module, SOURCE_MARK, self.get_data(self.path))
        if module.__name__.startswith(PREFIX):
            module.__dict__["__builtins__"] = {**vars(builtins), "__import__": _import_sibling}
        super().exec_module(module)


class _Finder(MetaPathFinder):
    """Finds the folders of plugins as packages, and the modules in them."""

    def __init__(self) -> None:
        self.folders: dict[str, str] = {}
        """Each folder by the name of its package."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As for any finder."""
        if path is None:
            return self._package(fullname) if fullname in self.folders else None
        if not fullname.startswith(PREFIX):
            return None
        loaders = (ExtensionFileLoader, EXTENSION_SUFFIXES), (_Loader, [".py"])
        found = (FileFinder(folder, *loaders).find_spec(fullname, target) for folder in path)
        return next((spec for spec in found if spec is not None), None)

    def _package(self, name: str) -> ModuleSpec | None:
        folder = self.folders[name]
        file = f"{folder}/__init__.py"
        if Path(file).is_file():
            return spec_from_file_location(name, file, loader=_Loader(name, file), submodule_search_locations=[folder])
        spec = ModuleSpec(name, None, is_package=True)
        spec.submodule_search_locations = [folder]
        return spec


_FINDER = _Finder()


def _import_sibling(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] = (),
    level: int = 0,
) -> ModuleType:
    """`__import__` of plugins: `import thermo` finds thermo.py beside, unless another module has the name."""
    own = str(globals["__name__"]) if globals is not None else ""
    package, top = own.partition(".")[0], name.partition(".")[0]
    if level or own == f"{package}.{top}" or not _is_sibling(top, package):
        return builtins.__import__(name, globals, locals, fromlist, level)
    module = builtins.__import__(f"{package}.{name}", globals, locals, fromlist, 0)
    return module if fromlist else sys.modules[f"{package}.{top}"]


def _is_sibling(name: str, package: str) -> bool:
    folder = _FINDER.folders.get(package)
    if folder is None or not any(Path(folder, file).is_file() for file in (f"{name}.py", f"{name}/__init__.py")):
        return False
    try:
        spec = find_spec(name)
    except ValueError:  # a module without a specification, such as `__main__`
        return False
    return spec is None or (spec.origin is not None and Path(spec.origin).resolve().is_relative_to(folder))
