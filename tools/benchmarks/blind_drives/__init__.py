"""Drives with undeclared effects: drawn from a seed, simulated by the plant alone, written as logs."""

import common as common  # before anything of fffo_drive: it chooses where compiled code is kept
