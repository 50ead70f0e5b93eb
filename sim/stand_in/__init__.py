"""A light stand-in for navigation: the real coordination code with robots that are points."""
