"""Fixtures of the fleet tests."""

from fleet.fleet_rig import facts_file  # noqa: F401
