"""The robot's plugin host: what plugins are written with and given, and the process that runs them."""
