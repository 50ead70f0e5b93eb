"""Rules, schedules and missions: what the coordinator makes tasks of."""
