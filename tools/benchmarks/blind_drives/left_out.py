"""Leave one kind out: effects outside the library, diagnosed without the curves that serve their kind.

Right: `unknown:` on a defensible axis, or a reported residual. Wrong: a law's name or another axis. A law whose numbers
describe the effect (a window where the sticky patch is, a wave of friction with the period of the damaged tooth or a
part of it) counts as wrong too, and is counted apart.
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
PERIOD_ERROR = 0.01  # largest error of a period that describes the effect, relative
ANGLE = {"output_angle": "motor_angle"}  # a place of every motor turn is one of the output too


class LeftOut(NamedTuple):
    """One drive."""

    seed: int
    kind: str
    said: str
    outcome: str  # "right axis", "residual reported", "wrong" or "silent"
    described: bool  # the numbers of every law that is named state what the effect is
    on_axis: bool  # the true effect depends on what is named; the angles of motor and output count as one


def judge(truth: Mapping[str, Any], report: dict[str, Any]) -> LeftOut:
    """What became of the one effect of a drive whose kind was left out."""
    effect = truth["effects"][0]
    allowed = {f"unknown:{axis}" for axis in effect["axes"]}
    strange = [one for one in claimed(report) if one["name"] not in allowed]
    if strange:
        outcome = "wrong"
    elif claimed(report):
        outcome = "right axis"
    else:
        outcome = "residual reported" if residual_is_reported(report) else "silent"
    described = all(describes(one["name"], one["parameters"], effect) for one in strange)
    on_axis = {ANGLE.get(one["axis"], one["axis"]) for one in claimed(report)} <= {
        ANGLE.get(axis, axis) for axis in effect["axes"]
    }
    return LeftOut(int(truth["seed"]), effect["name"], first_names(report), outcome, described, on_axis)


def describes(law: str, numbers: Mapping[str, float], effect: Mapping[str, Any]) -> bool:
    """Whether a law's numbers state what an effect outside the library is."""
    true = effect["parameters"]
    if effect["name"] == "odd_stick_patch" and law == "position_dependent_friction":
        away_rev = (numbers.get("centre_rev", 0.0) - true["centre_rev"] + 0.5) % 1.0 - 0.5
        return (
            numbers.get("window_share", 0.0) > 0.0
            and not numbers.get("period_rev", 0.0)
            and abs(numbers.get("pitch_rev", 0.0) - 1.0) < PERIOD_ERROR
            and abs(away_rev) < 0.5 * true["width_rev"]
        )
    if effect["name"] == "odd_alternate_turns" and law in ("friction_ripple", "position_dependent_friction"):
        order = numbers["order"] if law == "friction_ripple" else 1.0 / (numbers.get("period_rev", 0.0) or float("inf"))
        harmonic = order * true["turns"]
        return round(harmonic) > 0 and abs(harmonic / round(harmonic) - 1.0) < PERIOD_ERROR
    return False


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
    described = sum(one.outcome == "wrong" and one.described for one in judged)
    report.bounded("of the wrong names: laws whose numbers describe the effect", str(described))
    near = sum(one.outcome == "wrong" and one.on_axis for one in judged)
    report.bounded("of the wrong names: on a variable that the true effect depends on", str(near))
    report.notes.append("?: a name that the report itself puts in doubt, which does not count.")
    if ignored:
        report.notes.append(
            "**Nothing was left out:** this version of the search cannot. These are figures of the full search."
        )
    return report
