"""Units: plugins that make more of Devices."""
