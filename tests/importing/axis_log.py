"""A log of an axis with inertia and friction, in closed form, and the same written as other programs write it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ROWS = 1200
PERIOD_S = 2e-3
INERTIA, COULOMB, VISCOUS = 3e-3, 0.2, 0.01  # A s^2/rev, A, A/rps
POSITION_UNITS = {"rev": 1.0, "rad": 2.0 * np.pi, "deg": 360.0, "counts": 4096.0}  # of a turn
SPEED_UNITS = {"rps": 1.0, "rpm": 60.0, "rad/s": 2.0 * np.pi, "deg/s": 360.0}
TIME_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6}
CURRENT_UNITS = {"A": 1.0, "mA": 1e3}


class Truth(NamedTuple):
    """In s, rev, rps, A."""

    time_s: np.ndarray
    position_rev: np.ndarray
    velocity_rps: np.ndarray
    current_a: np.ndarray

    @property
    def columns(self) -> dict[str, np.ndarray]:
        return {
            "time_s": self.time_s, "position_rev": self.position_rev, "velocity_rps": self.velocity_rps,
            "current_a": self.current_a,
        }  # fmt: skip


def truth(jitter: float = 0.0, seed: int = 0) -> Truth:
    """Two sines of the velocity; stamps scatter by `jitter` periods at most."""
    stamps = np.arange(ROWS) + np.random.default_rng(seed).uniform(-jitter, jitter, ROWS)
    time_s = PERIOD_S * (stamps - stamps[0])
    slow, fast = 2.0 * np.pi * 0.9, 2.0 * np.pi * 2.3
    velocity = 3.0 * np.sin(slow * time_s) + 1.0 * np.sin(fast * time_s)
    position = 0.3 + 3.0 / slow * (1.0 - np.cos(slow * time_s)) + 1.0 / fast * (1.0 - np.cos(fast * time_s))
    acceleration = 3.0 * slow * np.cos(slow * time_s) + 1.0 * fast * np.cos(fast * time_s)
    current = INERTIA * acceleration + COULOMB * np.tanh(velocity / 0.05) + VISCOUS * velocity
    return Truth(time_s, position, velocity, current)


class Dialect(NamedTuple):
    """How a program writes its log."""

    delimiter: str = ","
    decimal: str = "."
    names: bool = True
    units: str = "brackets"  # "brackets", "line", "none"
    metadata: int = 0  # lines before the table
    time: str = "s"
    position: str = "rev"
    speed: str = "rps"
    current: str = "A"
    wrapped: bool = False
    reversed_current: bool = False
    ending: str = "\n"


def raw_columns(log: Truth, dialect: Dialect) -> dict[str, np.ndarray]:
    """The log in the units of a dialect, by heading."""
    turn = POSITION_UNITS[dialect.position]
    position = log.position_rev * turn
    if dialect.wrapped:
        position = np.mod(position, turn)
    if dialect.position == "counts":
        position = np.floor(position)
    sign = -1.0 if dialect.reversed_current else 1.0
    return {
        "Time": log.time_s * TIME_UNITS[dialect.time],
        "Actual position": position,
        "Actual velocity": log.velocity_rps * SPEED_UNITS[dialect.speed],
        "Actual current": sign * log.current_a * CURRENT_UNITS[dialect.current],
    }


def units_of(dialect: Dialect) -> list[str]:
    return [dialect.time, dialect.position, dialect.speed, dialect.current]


def as_text(log: Truth, dialect: Dialect, missing: np.ndarray | None = None) -> str:
    """The log as text. `missing` (rows, 4): cells that are empty."""
    columns = raw_columns(log, dialect)
    units = units_of(dialect)
    lines = [f"Parameter {k}:{dialect.delimiter}value {k}" for k in range(dialect.metadata)]
    names = [
        f"{name} [{unit}]" if dialect.units == "brackets" else name for name, unit in zip(columns, units, strict=True)
    ]
    if dialect.delimiter == " ":
        names = [name.replace(" ", "_", 1).replace(" ", "") for name in names]
    if dialect.names:
        lines.append(dialect.delimiter.join(names))
        if dialect.units == "line":
            lines.append(dialect.delimiter.join(units))
    values = np.stack(list(columns.values()), axis=1)
    for row, cells in enumerate(values):
        texts = [f"{cell:.9g}".replace(".", dialect.decimal) for cell in cells]
        if missing is not None:
            texts = ["nan" if gone else text for text, gone in zip(texts, missing[row], strict=True)]
        lines.append(dialect.delimiter.join(texts))
    return dialect.ending.join(lines) + dialect.ending
