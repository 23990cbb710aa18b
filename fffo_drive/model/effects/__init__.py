"""What a model may have beside J, Td and 2SEP friction: effects, each one file and one line of the registry."""
