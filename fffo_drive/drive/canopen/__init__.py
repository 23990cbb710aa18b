"""A CiA 402 servo drive on a CANopen bus: configuration, bring-up, and the cyclic exchange."""
