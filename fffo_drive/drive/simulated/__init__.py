"""The simulated drive: plant with its own friction and effects, CiA 402 device, in process and as a node."""
