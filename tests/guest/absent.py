"""What keeps a guest from being there at all: a package, the network, the machine. The stage then says so and is skipped."""


class GuestAbsentError(Exception):
    """There can be no guest here, and why."""
