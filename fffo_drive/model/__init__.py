"""The model of the axis: parameters, 2SEP friction, and the axis as one step."""
