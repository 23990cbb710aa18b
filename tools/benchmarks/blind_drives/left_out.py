"""Leave one kind out: effects outside the library, diagnosed without the curves that serve their kind.

Right: `unknown:` on a defensible axis, or a reported residual. Wrong: a law's name or another axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from common import Report
from engine import claimed, first_names, residual_is_reported

from .score import wilson

# Everything that shows the kind directly, by the names of the search: a word removes every curve over that axis,
# "drag(...)" and the like one sort of it, "x" a table. But for presliding, sgn(w) cos(output angle) is a law of the
# library, which goes too.
SERVED_BY: dict[str, frozenset[str]] = {
    "odd_speed_band": frozenset({"unknown:velocity"}),
    "odd_direction_angle": frozenset({
        "unknown:output_angle", "output_angle x velocity", "output_angle x speed (drag)", "position_dependent_friction",
    }),
    "odd_fatigue": frozenset({"unknown:memory"}),
    "odd_stick_patch": frozenset({
        "unknown:motor_angle", "motor_angle x velocity", "motor_angle x speed", "motor_angle x speed (drag)",
    }),
    "odd_current_heating": frozenset({"unknown:memory"}),
    "odd_two_levels": frozenset({"unknown:memory", "velocity x memory", "memory x speed"}),
    "odd_alternate_turns": frozenset({"unknown:motor_angle"}),
    "odd_eddy_brake": frozenset({"unknown:current", "unknown:torque", "velocity x current"}),
    "odd_late_kick": frozenset({"unknown:travel_since_reversal", "travel_since_reversal x speed"}),
    "odd_cable": frozenset({"unknown:memory"}),
}  # fmt: skip
MOST_WRONG = 0.05
ANGLE = {"output_angle": "motor_angle"}  # a place of every motor turn is one of the output too


class LeftOut(NamedTuple):
    """One drive."""

    seed: int
    kind: str
    said: str
    outcome: str  # "right axis", "residual reported", "wrong" or "silent"
    on_axis: bool  # the true effect depends on what is named; the angles of motor and output count as one


def judge(truth: Mapping[str, Any], report: dict[str, Any]) -> LeftOut:
    """What became of the one effect of a drive whose kind was left out."""
    effect = truth["effects"][0]
    names = [finding["name"] for finding in claimed(report)]
    allowed = {f"unknown:{axis}" for axis in effect["axes"]}
    if any(name not in allowed for name in names):
        outcome = "wrong"
    elif names:
        outcome = "right axis"
    else:
        outcome = "residual reported" if residual_is_reported(report) else "silent"
    on_axis = {ANGLE.get(one["axis"], one["axis"]) for one in claimed(report)} <= {
        ANGLE.get(axis, axis) for axis in effect["axes"]
    }
    return LeftOut(int(truth["seed"]), effect["name"], first_names(report), outcome, on_axis)


def left_out_report(judged: Sequence[LeftOut], ignored: Sequence[str]) -> Report:
    """Figures and a line a drive."""
    report = Report("blind_left_out", __doc__ or "")
    for outcome in ("right axis", "residual reported", "wrong", "silent"):
        share = wilson(sum(one.outcome == outcome for one in judged), len(judged))
        if outcome == "wrong":
            report.bounded("wrong name or axis", str(share), share.value <= MOST_WRONG, f"<= {100 * MOST_WRONG:.0f} %")
        else:
            report.bounded(outcome, str(share))
        report.facts[outcome] = share.found
    rows = [
        [one.kind, str(one.seed), ", ".join(f"`{n}`" for n in sorted(SERVED_BY[one.kind])), one.said, one.outcome]
        for one in sorted(judged, key=lambda one: (one.kind, one.seed))
    ]
    report.table(["kind", "drive", "left out of the search", "said", "is"], rows)
    near = sum(one.outcome == "wrong" and one.on_axis for one in judged)
    report.bounded("of the wrong names: on a variable that the true effect depends on", str(near))
    report.notes.append("?: a name that the report itself puts in doubt, which does not count.")
    if ignored:
        report.notes.append(
            "**Nothing was left out:** this version of the search cannot. These are figures of the full search."
        )
    return report
