"""A plugin from its manifest to its end: code, instance, states, start, reload."""
