"""The robot's plugin host: plugins, their tags and manifests, the manager, and the process that runs them."""
