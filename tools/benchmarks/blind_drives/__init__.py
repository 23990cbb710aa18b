"""Drives with effects that are not declared: drawn from a seed, simulated by the plant alone, written as logs."""
