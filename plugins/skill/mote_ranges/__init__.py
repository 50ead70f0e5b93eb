"""What motes' signals say of where the robot is."""
