"""The simulated drive as a CANopen node: CiA 301 and 402 above the plant, and the process that runs it."""
