"""Parts that people fit to their own robots, byte for byte: for trying the devices that drive them without them."""
