"""The field of sensor motes, their radio and the plumes that they sense."""
