"""Skills: plugins that know how to do something."""
