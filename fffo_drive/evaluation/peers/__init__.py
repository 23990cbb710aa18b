"""Peers of the controller, each from its publication: friction observers and disturbance observers on the same axis."""
