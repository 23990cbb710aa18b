"""Live changes: single keys, the model, the whole file. Each is checked before it is accepted."""

from __future__ import annotations

import difflib
from typing import Any, NamedTuple

from ..config.axis import TOGGLES, AxisFile, with_keys
from ..config.sections import NotchSection, notch_problem
from ..control.notch import MOST_NOTCHES
from ..documents import DocumentError, location_of
from ..model.parameters import ModelFile, content_hash
from ..workflows.plan import Plan, checked_plan, make_plan, proof_problems
from .states import Change

GAIN_KEYS = (
    "controller.proportional_a_per_rps",
    "controller.integral_a_per_rev",
    "controller.error_filter_s",
    "controller.observer.gain_nm_per_rev",
    "controller.observer.clamp_ratio",
    "controller.observer.feedback_band_rps",
)
LAW_KEYS = (
    "controller.feedforward.inertia",
    "controller.feedforward.preview",
    "controller.feedforward.delay_aware",
    "controller.adaptation.enabled",
)
NOTCH_KEYS = tuple(
    f"controller.notches.{place}.{key}" for place in range(MOST_NOTCHES) for key in NotchSection.model_fields
)

# of the axis file, fixed in a running loop; a change needs a restart of the service
FIXED = ("name", "drive", "envelope", "loop", "realtime", "commissioning")
FIXED_DAEMON = ("control_group", "clients", "supervisor_timeout_s", "scope", "foxglove")
APPLIED = ("controller", "recording", "profile", "daemon")


def live_keys(axis: AxisFile) -> tuple[str, ...]:
    """The keys that `set` has for this axis: of notches, those of the ones that it has."""
    there = len(axis.controller.notches) * len(NotchSection.model_fields)
    return (*GAIN_KEYS, *NOTCH_KEYS[:there], *LAW_KEYS)


def change_of(axis: AxisFile, key: str) -> Change:
    """Which kind of change a key is. Raises DocumentError for a key that `set` does not have."""
    known = live_keys(axis)
    if key in known:
        return Change.LAW if key in LAW_KEYS else Change.GAINS
    close = difflib.get_close_matches(key, known, 1, cutoff=0.5)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
    raise DocumentError(f"{key}: no key that may be set while the daemon runs; {hint} (others: edit the file, reload)")


def value_of(axis: AxisFile, key: str) -> Any:
    """The value of a dotted key."""
    value: Any = axis
    for part in location_of(key):
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def with_value(plan: Plan, toggle: int, key: str, value: float | bool) -> Plan:
    """The plan with one key changed. Raises DocumentError if the value, or the resulting law, is refused."""
    axis = with_keys(plan.axis, {key: value}, "set")
    problem = notch_problem(axis.controller, plan.axis.loop)
    if problem is not None:
        raise DocumentError(problem)
    _require_proof(axis, plan.model, toggle)
    return plan._replace(axis=axis)


def require_toggle(plan: Plan, toggle: int) -> None:
    """Raise DocumentError if the law is not proven stable with this toggle."""
    _require_proof(plan.axis, plan.model, toggle)


def _require_proof(axis: AxisFile, model: ModelFile, toggle: int) -> None:
    problems = proof_problems(axis, model, (toggle,))
    if problems:
        raise DocumentError("\n".join(problems))


def with_model(plan: Plan, toggle: int, model: ModelFile) -> Plan:
    """The plan with another model. Raises DocumentError if the law is refused with it."""
    return checked_plan(plan.path, plan.axis, model, (toggle,))


class Reload(NamedTuple):
    """Changes in a file that was read again."""

    plan: Plan
    applied: tuple[str, ...]  # changed sections and keys that are accepted
    restart: tuple[str, ...]  # changed ones that need a restart of the service


def reload(plan: Plan, toggle: int, rest: bool) -> Reload:
    """Read the axis file again; keys that cannot change in a running service keep their value and are reported.

    `rest`: no torque is requested, so the model may change. Raises DocumentError for an invalid file.
    """
    fresh = make_plan(plan.path)
    old, new = plan.axis, fresh.axis
    restart = [name for name in FIXED if getattr(old, name) != getattr(new, name)]
    daemon = new.daemon
    for name in FIXED_DAEMON:
        if getattr(old.daemon, name) != getattr(new.daemon, name):
            restart.append(f"daemon.{name}")
            daemon = daemon.model_copy(update={name: getattr(old.daemon, name)})
    kept = {name: getattr(old, name) for name in FIXED}
    axis = new.model_copy(update={**kept, "daemon": daemon})
    applied = [name for name in APPLIED if getattr(old, name) != getattr(axis, name)]
    if not rest and old.controller.feedforward != axis.controller.feedforward:
        restart.append("controller.feedforward (disable first, then reload again)")
        section = axis.controller.model_copy(update={"feedforward": old.controller.feedforward})
        axis = axis.model_copy(update={"controller": section})
    model_changed = content_hash(fresh.model) != content_hash(plan.model)
    model = fresh.model if model_changed else plan.model
    if model_changed and fresh.model.torque_constant_nm_per_a != plan.model.torque_constant_nm_per_a:
        restart.append("model: torque_constant_nm_per_a")
        model, model_changed = plan.model, False
    elif model_changed and not rest:
        restart.append("model (disable first, then reload again)")
        model, model_changed = plan.model, False
    if model_changed:
        applied.append("model")
    file_toggle = TOGGLES[axis.controller.observer.toggle]
    in_use = file_toggle if old.controller.observer.toggle != axis.controller.observer.toggle else toggle
    return Reload(checked_plan(plan.path, axis, model, (in_use,)), tuple(applied), tuple(restart))
