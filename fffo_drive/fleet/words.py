"""What quantities of records are called on pages."""

from __future__ import annotations

from datetime import UTC, datetime

from .spread import RESIDUAL

WORDS = {
    "inertia_nm_s2_per_rev": "inertia",
    "viscous_nm_per_rps": "viscous friction",
    "coulomb_nm": "Coulomb friction",
    "stribeck_nm": "Stribeck friction",
    "offset_nm": "constant torque",
    "viscous_excess_nm_per_rps": "viscous friction, difference by direction",
    "gravity_cos_nm": "gravity, cosine of the angle",
    "gravity_sin_nm": "gravity, sine of the angle",
    RESIDUAL: "rms of the residual",
}
SHORT = {
    "inertia_nm_s2_per_rev": "inertia", "viscous_nm_per_rps": "viscous", "coulomb_nm": "Coulomb",
    "stribeck_nm": "Stribeck", "offset_nm": "constant", "viscous_excess_nm_per_rps": "asymmetry",
    "gravity_cos_nm": "gravity cos", "gravity_sin_nm": "gravity sin", RESIDUAL: "residual",
}  # fmt: skip


def word_of(quantity: str) -> str:
    """A quantity in words."""
    return WORDS.get(quantity) or f"wave of order {_order(quantity)}"


def short_of(quantity: str) -> str:
    """A quantity in one or two words, for an axis."""
    return SHORT.get(quantity) or f"order {_order(quantity)}"


def _order(quantity: str) -> str:
    return quantity.removeprefix("wave_").removesuffix("_nm")


def day_of(time_s: float) -> str:
    """The day of a time (s, UTC)."""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d}"
