"""Find the effects that a model is missing: attribute its residual to effects and verify them on held-out runs."""
