"""All modules of messages, found rather than listed."""

import importlib
import pkgutil
from types import ModuleType

from robrain.protocol import messages


def message_modules() -> list[ModuleType]:
    """The modules of `robrain.protocol.messages` and its folders, by name."""
    found = pkgutil.walk_packages(messages.__path__, f"{messages.__name__}.")
    return [importlib.import_module(name) for name in sorted(one.name for one in found if not one.ispkg)]
