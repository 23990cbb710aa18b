"""The simulated drive: plant with friction and effects of its own, CiA 402 device, its two forms."""
