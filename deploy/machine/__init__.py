"""Files for real machines: service units, containers, router, devices, time, logs and updates."""
