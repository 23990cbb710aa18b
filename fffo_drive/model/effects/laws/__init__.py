"""One effect per file: its kernel, its search, and how to tell it from similar effects."""
