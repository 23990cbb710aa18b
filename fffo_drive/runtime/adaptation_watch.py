"""What was adapted has reached its bound: a warning, once for each of offset, Coulomb and viscous friction."""

from __future__ import annotations

from ..control.adaptation import COULOMB_AT_BOUND, OFFSET_AT_BOUND, VISCOUS_AT_BOUND

NAMES = {OFFSET_AT_BOUND: "offset", COULOMB_AT_BOUND: "Coulomb friction", VISCOUS_AT_BOUND: "viscous friction"}


def bound_names(bits: int) -> list[str]:
    """What is at its bound, by blocks.ADAPTED_TO_BOUND."""
    return [name for bit, name in NAMES.items() if bits & bit]


class BoundWatch:
    """Follows one loop's status word; what has left its bound and reaches it again is news again."""

    def __init__(self) -> None:
        self._known = 0

    def news(self, bits: int) -> str | None:
        """A sentence for what has reached its bound since the last call."""
        names = bound_names(bits & ~self._known)
        self._known = bits
        if not names:
            return None
        return (
            f"{' and '.join(names)} adapted to the bound: the axis has changed by more than "
            "controller.adaptation.bound_share allows; identify it again"
        )
