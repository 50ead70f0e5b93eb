"""The base station of the mote network."""
