"""What a run was worth: metrics, comparisons, replay."""
