"""The battery: state of charge and what is left."""
