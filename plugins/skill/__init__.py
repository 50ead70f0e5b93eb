"""Skills: plugins that estimate, map and plan."""
