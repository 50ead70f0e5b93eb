"""The process of one robot: its place on the wire, the operations on its plugins, faults, halts, text commands."""
