"""Floor plans: loaded from ROS maps or drawn, given to the physics as walls, and populated with robots and motes."""
