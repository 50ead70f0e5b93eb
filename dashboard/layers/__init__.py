"""The layers of the picture."""
