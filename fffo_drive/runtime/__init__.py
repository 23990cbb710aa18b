"""The loop, the memory that it shares with ordinary threads, and what supervises it."""
