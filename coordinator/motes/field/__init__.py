"""The mote field kept alive by the coordinator itself."""
