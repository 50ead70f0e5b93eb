"""The mote field as a network: energy, routes, coverage and tours. Pure functions."""
