"""Recharge: the robot docks at a charger, when told and when it must."""
