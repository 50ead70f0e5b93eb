"""What can go wrong with a plugin in a process of its own.

PluginError
└── PluginCrashed     its process has ended, or was killed because it did not come back; carries `.plugin`
Exception
├── PeerLost          the other end of a conversation has gone
└── PeerLate          the other end did not answer in time
"""

from robrain.agent.errors import PluginError


class PluginCrashed(PluginError):
    """The plugin's process has ended, or was killed because it did not come back."""


class PeerLost(Exception):
    """The other end of a conversation has gone."""


class PeerLate(Exception):
    """The other end did not answer in time; the conversation cannot be taken up again."""
