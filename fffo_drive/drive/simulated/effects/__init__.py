"""Effects that can be switched on in the plant, any number together: what a base model does not have."""
