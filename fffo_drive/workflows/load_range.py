"""The range of inertia of an axis whose load changes: from options and answers to the key of its axis file."""

from __future__ import annotations

from collections.abc import Callable

from ..config.axis import AxisFile
from ..config.sections import ordered_range
from ..documents import DocumentError
from ..model.parameters import ModelFile
from ..units import inertia_kg_m2


def inertia_range(least: float, largest: float) -> tuple[float, float]:
    """Both, in order. Raises DocumentError where they are no range."""
    try:
        return ordered_range(least, largest)
    except ValueError as error:
        raise DocumentError(f"inertia range: {error}") from None


def range_of(model: ModelFile, least: float, largest: float) -> tuple[float, float]:
    """The key inertia_range_kg_m2 for a range in the model's own unit: kg m2, of a linear axis kg.

    Raises DocumentError where it is none.
    """
    least, largest = inertia_range(least, largest)
    if model.units == "linear":
        least, largest = (float(f"{inertia_kg_m2(mass):.10g}") for mass in (least, largest))
    return least, largest


def ask_range(own: str, ask: Callable[[str, str], str | None]) -> tuple[float, float] | None:
    """Whether the load changes, and how far; None where it does not, or nobody answers. `ask`: question, proposal.

    `own`: the inertia that is known. Raises DocumentError for an answer that is neither.
    """
    no = "no"
    answer = ask(
        "does the load change? Type the least and the largest inertia of the axis, at the motor shaft and motor "
        f"included, in the unit of {own}, which is the model's",
        no,
    )
    if answer is None or answer.lower() in (no, "n"):
        return None
    try:
        least, largest = (float(word) for word in answer.replace(",", " ").split())
    except ValueError:
        raise DocumentError(f"inertia range: {answer!r}: two numbers, or no, are needed") from None
    return inertia_range(least, largest)


def with_range(axis_file: AxisFile, inertia_range_kg_m2: tuple[float, float] | None) -> AxisFile:
    """The file with this range; None: its own."""
    if inertia_range_kg_m2 is None:
        return axis_file
    controller = axis_file.controller.model_copy(update={"inertia_range_kg_m2": inertia_range_kg_m2})
    return axis_file.model_copy(update={"controller": controller})
