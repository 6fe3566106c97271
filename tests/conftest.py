"""What all tests share."""

from hypothesis import settings

# An example's time says how busy the machine is: `pytest --timeout` alone ends what hangs.
settings.register_profile("default", deadline=None)
settings.load_profile("default")
