"""`robrain bench log`: a public lidar log through localisation and mapper."""
