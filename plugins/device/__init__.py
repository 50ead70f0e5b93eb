"""Devices: plugins that drive one piece of hardware."""
