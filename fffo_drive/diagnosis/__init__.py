"""What a model lacks: the residual traced to effects, with the proof on held-out runs."""
