"""Margins of a control law, the file's or a user's own, and whether a drive may be run with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..config.checks import law_margins, own_margins
from ..config.drive_section import SimulatedDriveSection
from ..control.own_law import ControlLaw, require_law
from ..control.stability import Margins
from ..documents import DocumentError
from ..workflows.plan import Plan
from .measured import Axis, read_axis


def margins(axis: Axis | str | Path, controller: ControlLaw | None = None, *, speed_rps: float = 1.0) -> Margins:
    """Phase margin (deg), gain margin (factor) and crossover (Hz) of the loop on the axis' model, in motion.

    `controller`: a law of your own, linearised in steady motion at `speed_rps`; its state has to be a NamedTuple of
    numbers. None: the law of the axis. Raises DocumentError.
    """
    chosen = axis if isinstance(axis, Axis) else read_axis(axis)
    if controller is not None:
        require_law("controller", controller)
    if controller is None:
        return law_margins(chosen.file, chosen.model, chosen.file.controller.observer.toggle != "off")
    return own_margins(chosen.file, chosen.model, controller, speed_rps)


def with_controller(plan: Plan, law: ControlLaw | None) -> Plan:
    """The plan with a law of a user's own, if the drive may be run with it. Raises DocumentError."""
    if law is not None:
        require_law("controller", law)
    if law is None or isinstance(plan.axis.drive, SimulatedDriveSection):
        return plan._replace(controller=law)
    if not law.compiled:
        raise DocumentError(f"controller {law.name!r}: a drive needs it compiled: put @njit above its step")
    section = plan.axis.controller
    moving_rps = np.abs(plan.profile.values[plan.profile.values != 0.0])
    found = own_margins(plan.axis, plan.model, law, float(np.median(moving_rps)) if moving_rps.size else 0.0)
    enough = found.phase_deg >= section.phase_margin_deg and found.gain >= section.gain_margin
    if not (enough or section.accept_unproven):
        raise DocumentError(
            f"controller {law.name!r}: its margins are {found.phase_deg:.1f} deg and {found.gain:.2f}: below "
            f"phase_margin_deg {section.phase_margin_deg:g} or gain_margin {section.gain_margin:g} of {plan.path}: "
            "lower its gains"
        )
    return plan._replace(controller=law)
