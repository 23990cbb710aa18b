"""What a reader of a diagnosis has to be told beside its verdict."""

from __future__ import annotations

from ..identification.facts import DriveFacts
from .results import ErrorFigures, Interval
from .selection import Selection

Errors = tuple[ErrorFigures | None, ErrorFigures | None]  # held out, before and after


def cautions(selected: Selection, facts: DriveFacts, held_out: Errors) -> list[str]:
    """One sentence each."""
    found = []
    if selected.left is not None and selected.left[2] <= 0.01:
        name, share, _ = selected.left
        found.append(
            f"{name} would take away another {100.0 * share:.1f} % of the squared residual: significant, but too small "
            "to be called an effect"
        )
    if held_out[0] is None:
        found.append("no held-out run: the errors before and after are those of the fit runs")
    if any(e.per_run for e in selected.fitted.effects) and not facts.absolute_angle:
        found.append("a periodic effect has another datum in each run: it cannot be compensated without a homed angle")
    return found + _grown(*held_out)


def _grown(before: ErrorFigures | None, after: ErrorFigures | None) -> list[str]:
    """What was chosen on the fit runs does harm on the others: the choice stands, and is not to be trusted there."""
    if before is None or after is None:
        return []
    pairs = (
        ("torque", before.torque_rms_nm, after.torque_rms_nm),
        ("velocity", before.velocity_rms_rps, after.velocity_rms_rps),
    )
    return [
        f"on the held-out runs the error in {name} is {100.0 * (last.value / first.value - 1.0):.0f} % larger with "
        "what was found: compare the runs before it is put in service"
        for name, first, last in pairs
        if _beyond(first, last)
    ]


def _beyond(first: Interval, last: Interval) -> bool:
    return first.value > 0.0 and last.low > first.high
