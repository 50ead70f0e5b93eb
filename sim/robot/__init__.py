"""A simulated robot: body, wheels, lidar, camera and electronics."""
