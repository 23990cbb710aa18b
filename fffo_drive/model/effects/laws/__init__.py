"""One effect a file: its kernel, what it is looked for with, and what tells it from its lookalikes."""
