"""The tasks of a user, as functions that return records; the commands parse and print."""
