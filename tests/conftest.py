"""For all tests: a timing never fails one, so hypothesis sets no deadline."""

from hypothesis import settings

settings.register_profile("robrain", deadline=None)
settings.load_profile("robrain")
