"""What dashboard and reports draw alike: map, colours, a robot's history."""
