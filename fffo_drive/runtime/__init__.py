"""The real-time loop, the memory that it shares with ordinary threads, and its supervision."""
