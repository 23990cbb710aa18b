"""Random axes that controllers are tried on, and what is judged there: part of no wheel, for benchmarks and tests."""
