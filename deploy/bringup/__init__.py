"""`robrain bringup`: a new robot's wheels, lidar and battery, checked step by step, and what was found in its file."""
