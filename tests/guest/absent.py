"""The error that this machine cannot run a guest."""


class GuestAbsentError(Exception):
    """Raised if a package, the network or the architecture for a guest is missing; the stage is skipped."""
