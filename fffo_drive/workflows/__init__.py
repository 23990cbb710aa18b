"""What a user does, as functions that return records; the commands parse and print."""
