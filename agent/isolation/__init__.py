"""Plugins in separate processes: `isolation = "process"` in a manifest, and foreign plugins in any language."""
