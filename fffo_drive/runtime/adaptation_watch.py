"""A warning when the adaptation of offset, Coulomb or viscous friction reaches its bound."""

from __future__ import annotations

from ..control.adaptation import COULOMB_AT_BOUND, OFFSET_AT_BOUND, VISCOUS_AT_BOUND

NAMES = {OFFSET_AT_BOUND: "offset", COULOMB_AT_BOUND: "Coulomb friction", VISCOUS_AT_BOUND: "viscous friction"}


def bound_names(bits: int) -> list[str]:
    """Names of the parameters at their bounds, from blocks.ADAPTED_TO_BOUND."""
    return [name for bit, name in NAMES.items() if bits & bit]


class BoundWatch:
    """Monitors the status word of one loop. A bound that was left and is reached again is reported again."""

    def __init__(self) -> None:
        self._known = 0

    def news(self, bits: int) -> str | None:
        """A sentence for each bound reached since the last call; None if there is none. `bits`: ADAPTED_TO_BOUND."""
        names = bound_names(bits & ~self._known)
        self._known = bits
        if not names:
            return None
        return (
            f"adaptation of {' and '.join(names)} has reached its bound: the axis has changed by more than "
            "controller.adaptation.bound_share allows; identify it again"
        )
