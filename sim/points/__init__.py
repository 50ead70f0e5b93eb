"""Robots that are points, on the floor that the full simulation uses: the fidelity `points`."""
