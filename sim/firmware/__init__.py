"""Firmware of the simulated robot: the nodes on its CAN bus, and the battery behind one of them."""
