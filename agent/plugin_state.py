"""Where a plugin stands."""

from enum import StrEnum


class PluginState(StrEnum):
    """`discovered → loaded → active`; `inactive`, `faulted` and `halted` come with why; `unloaded` is the end."""

    DISCOVERED = "discovered"
    LOADED = "loaded"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FAULTED = "faulted"
    HALTED = "halted"
    UNLOADED = "unloaded"
