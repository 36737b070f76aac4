"""The reason why this machine cannot run a guest."""


class GuestAbsentError(Exception):
    """No guest on this machine: a package, the network or the architecture is missing; the stage is skipped."""
