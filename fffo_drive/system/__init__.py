"""The machine: what stands in the way of a loop on it (doctor), and putting the service in place (install)."""
