"""The manual: its pages, what is generated from the code, and how they become static HTML."""
