"""A fleet: one small additive record of every run, a store of them, and what they say together."""
