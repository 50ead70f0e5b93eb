"""The commands of coordinators: one that leads, one that stands by, several that robots elect one of."""
