"""The lidar."""
