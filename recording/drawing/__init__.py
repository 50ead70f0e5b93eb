"""Drawing that dashboard and reports share: map, colours, a robot's history."""
