"""LDROBOT's LD06 and LD19, on a serial line."""
