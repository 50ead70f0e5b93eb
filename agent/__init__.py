"""The robot's plugin host: the base of plugins, their environment, and the process that runs them."""
