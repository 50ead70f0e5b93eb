"""The robot's CAN bus: its frames, and the python-can interface that carries it over Zenoh."""
