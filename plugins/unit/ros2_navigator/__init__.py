"""A driver for robots whose own Nav2 drives."""
