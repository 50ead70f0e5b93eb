"""What Foxglove draws."""
