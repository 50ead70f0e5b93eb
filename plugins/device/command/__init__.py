"""The way in for those outside who speak the text form."""
