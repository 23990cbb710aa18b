"""Evaluation of runs: metrics, comparisons, replay."""
