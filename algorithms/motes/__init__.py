"""The mote field as a network: energy, routes, coverage, tours and relay places. Pure functions."""
