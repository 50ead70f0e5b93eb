"""`robrain bringup`: it checks a new robot's wheels, lidar and battery, and puts the results into its file."""
