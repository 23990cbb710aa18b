"""Drives behind one port: the port itself, the CANopen backend and the simulated drive."""
