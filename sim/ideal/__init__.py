"""Ideal motion: exploration without motion control, localisation and messages, to judge strategies by themselves."""
