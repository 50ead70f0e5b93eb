"""Importing a plugin's class from the module that its manifest names; modules are executed again after an edit."""

import importlib
import importlib.util
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType

from robrain.agent.errors import ManifestError, PackageMissing
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin
from robrain.protocol.extras import missing_package

SOURCE_MARK = "__robrain_source__"
"""In a module: the bytes that it was read from, so that a later load sees whether they were edited."""


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
        module = _import_file(file, fresh=fresh) if file is not None else _import_module(name, fresh=fresh)
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


def _import_module(name: str, *, fresh: bool) -> ModuleType:
    module = importlib.import_module(name)
    if not fresh or module.__spec__ is None or module.__spec__.origin is None:
        return module
    return _execute(name, Path(module.__spec__.origin), module)


def _import_file(path: Path, *, fresh: bool) -> ModuleType:
    name = f"robrain_plugin_{path.stem}_{abs(hash(path.resolve())):x}"
    before = sys.modules.get(name)
    if before is not None and not fresh and before.__dict__.get(SOURCE_MARK) == path.read_bytes():
        return before  # as any import: plugins in one file share the interfaces that it declares
    return _execute(name, path, before)


def _execute(name: str, path: Path, before: ModuleType | None) -> ModuleType:
    importlib.invalidate_caches()
    if before is not None:
        # Python takes a byte-code file as current if the source's size and time stamp (whole seconds) agree: it would
        # miss a quick edit.
        with suppress(NotImplementedError):  # raised where Python keeps no byte-code files: there is nothing to remove
            Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)
    source = path.read_bytes()
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    setattr(module, SOURCE_MARK, source)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        if before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = before
        raise
    return module
