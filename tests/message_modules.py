"""All modules of messages, found rather than listed."""

import importlib
import pkgutil
from types import ModuleType

from robrain.protocol.wire import messages


def message_modules() -> list[ModuleType]:
    """The modules of `robrain.protocol.wire.messages`, by name."""
    names = sorted(found.name for found in pkgutil.iter_modules(messages.__path__))
    return [importlib.import_module(f"{messages.__name__}.{name}") for name in names]
