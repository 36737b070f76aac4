"""What keeps a guest from being there at all: a package, the network, the machine."""


class GuestAbsentError(Exception):
    """There can be no guest here, and why; the stage says so and is skipped."""
