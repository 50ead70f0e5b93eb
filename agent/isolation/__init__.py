"""Plugins in processes of their own: `isolation = "process"` in a manifest, and foreign plugins in any language."""
