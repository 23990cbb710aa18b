"""Drives behind one port: the border itself, the CANopen backend and the simulated drive."""
