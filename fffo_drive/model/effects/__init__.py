"""Effects, in addition to J, Td and 2SEP friction: each is one file and one line of the registry."""
