"""How long an isolated plugin may take, and how much memory."""

import msgspec

from robrain.agent.manifest import Manifest

CALL_SHARE = 0.8
"""Of the manifest's `hang_s`: the process is killed before the host takes the whole plugin for hung."""
START_SHARE = 0.3
"""Of the manifest's `start_s`, for its process, `init` and `activate`, which may come together."""


class Limits(msgspec.Struct, frozen=True):
    """Time that the plugin's process spends waiting for its parent does not count."""

    call_s: float = 4.0
    """A step, a call, a notification."""
    start_s: float = 6.0
    """The start of the process, its `init`, and its `activate`: code is imported, hardware looked for."""
    halt_s: float = 0.2
    """A process that has not acknowledged an emergency halt by then is killed."""
    memory_mb: int = 4096
    """Data that the process may allocate; beyond it, allocations fail there."""


def limits_of(manifest: Manifest) -> Limits:
    """The limits that a manifest sets."""
    return Limits(call_s=CALL_SHARE * manifest.tag.hang_s, start_s=START_SHARE * manifest.tag.start_s)
