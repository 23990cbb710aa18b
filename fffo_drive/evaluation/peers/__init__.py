"""Published laws for comparison with the controller: friction observers and disturbance observers on the same axis."""
