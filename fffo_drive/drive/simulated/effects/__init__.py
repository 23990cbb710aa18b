"""Effects of the plant that a base model lacks; a configuration switches on any number of them."""
