"""Drives with undeclared effects: drawn from a seed, simulated by the plant alone, written as logs."""
