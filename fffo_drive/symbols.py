"""Names, symbols and units of the model's numbers, once: what reports, fits and tables call them."""

from __future__ import annotations

from typing import NamedTuple


class Symbol(NamedTuple):
    """How a number of the model is written."""

    symbol: str  # in plain ASCII, as a terminal prints it
    meaning: str
    unit: str  # of a rotary axis; `units.unit_on` gives that of a linear one

    @property
    def greek(self) -> str:
        """The symbol as the paper prints it."""
        return GREEK.get(self.symbol, self.symbol)

    @property
    def label(self) -> str:
        """Symbol and meaning, for a row of a table."""
        return f"{self.greek}, {self.meaning}"


GREEK = {"sigma": "σ", "delta": "δ"}
# friction of the 2SEP model, in the order of Table I of the paper and of every vector of them
FRICTION = {
    "viscous_nm_per_rps": Symbol("sigma", "viscous friction", "Nm/rps"),
    "coulomb_nm": Symbol("Fc", "Coulomb level", "Nm"),
    "static_nm": Symbol("Fs", "level at the lowest speed", "Nm"),
    "stribeck_velocity_rps": Symbol("Vs", "Stribeck velocity", "rps"),
    "stribeck_exponent": Symbol("delta", "Stribeck exponent", "-"),
    "stiffness_per_rev": Symbol("K", "presliding", "1/rev"),
    "attraction_nm_per_rev": Symbol("B", "frictional lag", "Nm/rev"),
}
SYMBOLS = {
    "inertia_nm_s2_per_rev": Symbol("J", "inertia", "Nm s^2/rev"),
    "delay_s": Symbol("Td", "delay", "s"),
    **FRICTION,
    "sensor_lag_s2": Symbol("sensor lag", "second-order lag of the position", "s^2"),
    "offset_nm": Symbol("offset", "constant torque", "Nm"),
}
