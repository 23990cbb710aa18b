"""Logs of other programs: read as they are, recognised by names, units and data, written as recordings of ours."""
