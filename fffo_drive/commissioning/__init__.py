"""Before any loop is closed: small bounded current pulses check signs, scales, delay, and what stops the axis."""
