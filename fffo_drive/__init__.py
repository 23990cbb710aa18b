"""Real-time drive controller for BLDC servo axes over CANopen: PI plus feed-forward friction observer (FFFO)."""

__version__ = "0.1.0"
