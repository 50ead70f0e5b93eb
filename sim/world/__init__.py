"""The arena: floor, bodies, sensors and chargers, faults, and the referee that has the true state."""
