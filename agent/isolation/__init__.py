"""Plugins in a process of their own: `isolation = "process"` in a manifest's [tag], for the live drive."""

from robrain.agent.isolation.errors import PluginCrashed
from robrain.agent.isolation.isolated_plugin import IsolatedPlugin, isolated_class
from robrain.agent.isolation.limits import Limits

__all__ = ["IsolatedPlugin", "Limits", "PluginCrashed", "isolated_class"]
