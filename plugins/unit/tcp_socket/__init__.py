"""The text form over a socket."""
