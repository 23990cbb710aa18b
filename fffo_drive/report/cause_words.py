"""What an effect of a diagnosis does, in a sentence for the owner of the machine: how much and where."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..diagnosis.results import Finding
from ..model.effects.registry import law_of
from ..model.parameters import ModelFile
from .diagnose_figures import DiagnosisWords
from .document import significant

DIGITS = 2
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "\u00b5"))  # smallest value that is written with each
WITHOUT_PREFIX = ("rev", "rps", "%")


def sized(value: float, unit: str) -> str:
    """A quantity as a person writes it: 0.0123 Nm is 12 mNm, 26.3 Nm stays."""
    scale, prefix = next((one for one in PREFIXES if abs(value) >= one[0]), PREFIXES[-1 if value else 0])
    if unit in WITHOUT_PREFIX:
        scale, prefix = PREFIXES[0]
    return f"{significant(value / scale, DIGITS)} {prefix}{unit}"


def percent(share: float) -> str:
    """A share."""
    return f"{significant(100.0 * share, DIGITS)} %"


@dataclass(frozen=True)
class _Effect:
    """A finding with what its numbers are compared to."""

    finding: Finding
    model: ModelFile | None
    words: DiagnosisWords

    def __getitem__(self, name: str) -> float:
        """A parameter; one with a value for each run: their mean. 0 where it has none."""
        values = [number.value for number in self.finding.parameters if number.name == name]
        return float(np.mean(values)) if values else 0.0

    def wave(self, ending: str) -> float:
        """Amplitude of a wave; of one with a phase for each run: the mean."""
        runs: dict[str | None, list[float]] = {}
        for number in self.finding.parameters:
            if number.name in (f"cos{ending}", f"sin{ending}"):
                runs.setdefault(number.per_run, []).append(number.value)
        return float(np.mean([math.hypot(*values) for values in runs.values()])) if runs else 0.0

    def quantity(self, value: float, unit: str) -> str:
        """A size in the unit here for that of a rotary axis."""
        return sized(abs(value), self.words.unit(unit))

    def one_way(self, value: float, base: str, what: str, unit: str) -> str:
        """Friction that is higher one way than the other, by `value`, where the mean of both is `base` of the model."""
        level = getattr(self.model.friction, base).value if self.model is not None else 0.0
        share = f" ({percent(abs(value) / level)})" if level > 0.0 else ""
        size = f"{self.quantity(value, unit)}{share}"
        return f"{what} is {size} {_one_way(value)}"


def _way(value: float) -> str:
    return "forwards" if value > 0.0 else "backwards"


def _one_way(excess: float) -> str:
    return f"higher {_way(excess)} and the same amount lower {_way(-excess)}"


def _rises(value: float) -> str:
    return "rises" if value > 0.0 else "falls"


def _per_turn(effect: _Effect) -> str:
    return f"with {effect['order']:.4g} periods per motor turn"


SAID: dict[str, Callable[[_Effect], str]] = {
    "torque_offset": lambda e: f"a constant torque of {e.quantity(e['torque_nm'], 'Nm')} pulls {_way(-e['torque_nm'])}",
    "asymmetric_coulomb": lambda e: f"sliding friction is {percent(abs(e['share']))} {_one_way(e['share'])}",
    "asymmetric_viscous": lambda e: e.one_way(
        e["excess_nm_per_rps"], "viscous_nm_per_rps", "viscous friction", "Nm/rps"
    ),
    "stribeck_shape": lambda e: (
        f"friction near standstill is {e.quantity(e['bump_nm'], 'Nm')} {'higher' if e['bump_nm'] > 0.0 else 'lower'}; "
        f"the difference fades above about {e.quantity(e['speed_rps'], 'rps')}"
    ),
    "presliding_shape": lambda e: f"{e.quantity(e['torque_nm'], 'Nm')} of the friction builds up in a second stage",
    "second_surface": lambda e: (
        f"{e.quantity(e['level_nm'], 'Nm')} of the friction builds up only over {e.quantity(e['travel_rev'], 'rev')}"
    ),
    "dwell_stiction": lambda e: (
        f"the break-away torque rises by up to {e.quantity(e['peak_nm'], 'Nm')} with the time at rest (time constant "
        f"{sized(e['tau_s'], 's')})"
    ),
    "load_dependent_friction": lambda e: f"friction takes {percent(e['share'])} of the torque that is transmitted",
    "position_dependent_friction": lambda e: (
        f"friction varies by up to {percent(max(e.wave('_share'), abs(e['window_share'])))} along the travel"
    ),
    "frictional_lag": lambda e: (
        f"{percent(abs(e['share']))} of the friction follows a change of speed only over "
        f"{e.quantity(e['length_rev'], 'rev')} of travel"
    ),
    "quadratic_drag": lambda e: (
        f"drag grows with the square of the speed, {e.quantity(e['drag_nm_per_rps2'], 'Nm/rps2')}"
    ),
    "friction_ripple": lambda e: f"friction varies by \u00b1{percent(e.wave('_share'))} {_per_turn(e)}",
    "coulomb_drift": lambda e: (
        f"sliding friction {_rises(e['share'])} by {percent(abs(e['share']))} (time constant {sized(e['tau_s'], 's')})"
    ),
    "viscous_drift": lambda e: (
        f"viscous friction {_rises(e['change_nm_per_rps'])} by {e.quantity(e['change_nm_per_rps'], 'Nm/rps')} (time "
        f"constant {sized(e['tau_s'], 's')})"
    ),
    "torque_constant_drift": lambda e: (
        f"the torque per ampere {_rises(-e['share'])} by {percent(abs(e['share']))} "
        + (f"from {e['begin_s']:.4g} s on " if e["begin_s"] else "")
        + f"(time constant {sized(e['tau_s'], 's')})"
    ),
    "cogging": lambda e: f"a torque of \u00b1{e.quantity(e.wave('_nm'), 'Nm')} {_per_turn(e)}",
    "torque_ripple": lambda e: f"the motor's torque varies by \u00b1{percent(e.wave('_share'))} {_per_turn(e)}",
    "unbalance": lambda e: (
        f"the weight of the load needs up to {e.quantity(e.wave('_nm'), 'Nm')} at the motor shaft, depending on the "
        "output angle"
    ),
    "torque_saturation": lambda e: (
        f"far above {e.quantity(e['knee_a'], 'A')} the motor gives {percent(e['share'])} less torque"
    ),
    "dead_zone": lambda e: f"{e.quantity(e['lost_nm'], 'Nm')} of torque is lost above {sized(e['width_a'], 'A')}",
    "voltage_limit": lambda e: (
        f"the voltage leaves no torque at {e.quantity(e['no_load_rps'], 'rps')}, and at most "
        f"{e.quantity(e['stall_nm'], 'Nm')} at standstill"
    ),
    "delay": lambda e: f"torque comes {sized(e['delay_s'], 's')} later than the model says",
    "current_lag": lambda e: (
        f"{percent(e['share'])} of the torque follows with a time constant of {sized(e['tau_s'], 's')}"
    ),
    "elasticity": lambda e: (
        f"{percent(e['share'])} of the inertia is behind a spring and swings at {e['frequency_hz']:.3g} Hz"
    ),
    "backlash": lambda e: (
        f"{percent(e['share'])} of the inertia is behind a backlash of {e.quantity(e['gap_rev'], 'rev')} at the motor "
        "shaft"
    ),
    "resolver_error": lambda e: (
        f"the measured angle is wrong by up to "
        f"{e.quantity(math.hypot(e['cos1_rev'], e['sin1_rev']) + math.hypot(e['cos2_rev'], e['sin2_rev']), 'rev')} "
        "within a turn"
    ),
    "periodic_disturbance": lambda e: (
        f"a torque of \u00b1{e.quantity(e.wave('_nm'), 'Nm')} at {e['frequency_hz']:.4g} Hz, whatever the axis does"
    ),
}


def in_words(finding: Finding, model: ModelFile | None, words: DiagnosisWords) -> str:
    """What it does, without a full stop: in numbers where its law has a sentence here, else by its name and size."""
    size = f"{sized(finding.torque_rms_nm, words.torque_unit)} rms"
    law = law_of(finding.name)
    said = SAID.get(law.name)
    if said is None or finding.alternatives:
        return words.text(f"{size}, {law.meaning if law.name != 'lookup' else 'a torque of unknown cause'}")
    return words.text(f"{said(_Effect(finding, model, words))} ({size})")
