"""Units: plugins that combine and control Devices."""
