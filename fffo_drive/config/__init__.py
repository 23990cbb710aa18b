"""Configuration files as checked records, and what the rest of the package is built from."""
