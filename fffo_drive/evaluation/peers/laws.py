"""The laws of a comparison on one axis: this project's and its peers, with the same margins.

Laws with a friction model have the gains of PI+FFFO+: their linear loop is the same PI plus L / s, wherever L is added.
Those with a disturbance observer have the gains of `design.observer_gains` for the margins of that loop. The friction
models are fitted to one record of the same plant; then all are changed by the same share.

On another axis the gains follow from inertia, torque constant and delay: with time in units of the delay the loop is
the same except for the viscous damping, which is small compared with J / Td.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from ...arrays import Floats
from ...control.controller import ControllerConfig
from ...control.pi import PiConfig
from ...control.stability import LinearAxis, Margins, loop_margins
from ...drive.simulated.parameters import PlantConfig, delay_budget
from ...identification.tuning import Wish
from ...model.friction import FrictionConfig
from ...units import inertia_nm_s2_per_rev
from ..campaign import Candidate
from .constants import PeerConfig
from .design import ObserverForm, ObserverGains, observer_gains
from .disturbance_observer import ObserverLoop
from .fit import LUGRE_START, SLIP_START, TABLE_1, TwoSurfaces, fit_friction
from .loop import PeerLaw
from .luenberger import LuenbergerLoop, further_pole_rad_per_s
from .lugre import LugreConfig, LugreModel
from .maxwell_slip import SlipConfig, SlipModel

Model = TypeVar("Model", FrictionConfig, TwoSurfaces, LugreModel, SlipModel)
Contact = TypeVar("Contact", FrictionConfig, TwoSurfaces)

PI, FFFO, PLUS = "pi", "pi+fffo", "pi+fffo+"
OWN_LAWS = (PI, FFFO, PLUS)
DOB_ORDER, ESO_ORDER = 1, 2


class Models(NamedTuple):
    """One friction map in the parameters of each model."""

    two_state: FrictionConfig
    lugre: LugreModel
    slip: SlipModel
    two_surfaces: TwoSurfaces | None = None


class Scale(NamedTuple):
    """Factors on a friction map, those of drive.simulated.surfaces.FrictionConfig.scaled."""

    level: float = 1.0
    rise: float = 1.0
    stribeck_velocity: float = 1.0
    stiffness: float = 1.0
    memory: float = 1.0


class AxisNumbers(NamedTuple):
    """What the gains depend on."""

    inertia_nm_s2_per_rev: float
    torque_constant_nm_per_a: float
    delay_s: float  # end to end, hold included
    sensor_delay_s: float


class PeerDesign(NamedTuple):
    """Gains on the nominal axis, with the plant and margins that they are for."""

    nominal: AxisNumbers
    margins: Margins  # of PI+FFFO+
    disturbance: ObserverGains  # Q of first order
    extended_state: ObserverGains  # Q of second order
    friction_state: ObserverGains  # friction observer on the position


def axis_numbers(plant: PlantConfig) -> AxisNumbers:
    """Numbers of a plant, effects left out."""
    return AxisNumbers(
        inertia_nm_s2_per_rev(plant.inertia_kg_m2),
        plant.torque_constant_nm_per_a,
        plant.delay_s + plant.extra_delay_s,
        delay_budget(plant).tracking_loop_s,
    )


def fit_models(velocity_rps: Floats, friction_nm: Floats, period_s: float) -> tuple[Models, tuple[float, ...]]:
    """All models along one record, arrays (n,); and the share of the friction (rms) that each of them leaves."""
    found = [fit_friction(start, velocity_rps, friction_nm, period_s) for start in (TABLE_1, LUGRE_START, SLIP_START)]
    return Models(*(one.model for one in found)), tuple(one.left for one in found)


def scaled(models: Models, scale: Scale) -> Models:
    """The models of a friction map whose plant is scaled likewise."""

    def changed(model: Model) -> Model:
        coulomb_nm = scale.level * model.coulomb_nm
        return model._replace(
            coulomb_nm=coulomb_nm,
            static_nm=coulomb_nm + scale.level * scale.rise * (model.static_nm - model.coulomb_nm),
            stribeck_velocity_rps=scale.stribeck_velocity * model.stribeck_velocity_rps,
        )

    def contact(model: Contact) -> Contact:
        return changed(model)._replace(
            stiffness_per_rev=scale.stiffness * model.stiffness_per_rev,
            attraction_nm_per_rev=model.attraction_nm_per_rev / scale.memory,
        )

    lugre, slip, both = changed(models.lugre), changed(models.slip), models.two_surfaces
    return Models(
        contact(models.two_state),
        lugre._replace(stiffness_nm_per_rev=scale.stiffness * lugre.stiffness_nm_per_rev),
        slip._replace(
            stiffness_nm_per_rev=scale.stiffness * slip.stiffness_nm_per_rev,
            attraction_nm_per_s=slip.attraction_nm_per_s / scale.memory,
        ),
        both
        and contact(both)._replace(
            level_nm=scale.level * both.level_nm,
            rise_nm=scale.level * scale.rise * both.rise_nm,
            travel_rev=both.travel_rev / scale.stiffness,
            speed_rps=scale.stribeck_velocity * both.speed_rps,
            memory_rev=scale.memory * both.memory_rev,
        ),
    )


def wrong(models: Models, share: float, seed: int, sign: float | None = None) -> Models:
    """Each parameter of each model changed by `share`; the seed draws the signs, the same for equal names, where none
    is given.
    """
    names = sorted({name for model in models if model is not None for name in model._fields if name != "omega_form"})
    drawn = np.random.default_rng([seed, 0xF]).choice((-1.0, 1.0), len(names))
    factors = {
        name: 1.0 + share * (float(own) if sign is None else sign) for name, own in zip(names, drawn, strict=True)
    }

    def changed(model: Model) -> Model:
        return model._replace(**{n: factors[n] * getattr(model, n) for n in model._fields if n in factors})

    both = models.two_surfaces
    return Models(changed(models.two_state), changed(models.lugre), changed(models.slip), both and changed(both))


def error_filter_s(config: ControllerConfig) -> float:
    """Time constant of the error's filter."""
    return -config.period_s / math.log1p(-config.error_share) if config.error_share < 1.0 else 0.0


def known_numbers(plus: ControllerConfig) -> AxisNumbers:
    """What PI+FFFO+ with inertia torque and preview takes its axis to be."""
    shifts = plus.feedforward
    sensor_s = shifts.behind_ticks * plus.period_s
    return AxisNumbers(
        shifts.inertia_nm_s2_per_rev,
        plus.torque_constant_nm_per_a,
        shifts.ahead_ticks * plus.period_s + sensor_s,
        sensor_s,
    )


def design_for(plus: ControllerConfig, numbers: AxisNumbers, viscous_nm_per_rps: float) -> PeerDesign:
    """Gains of all observers with the margins of PI+FFFO+ on this axis. ValueError: none has them.

    The friction observer on the position needs the friction model of PI+FFFO+ as well.
    """
    axis = LinearAxis(
        numbers.inertia_nm_s2_per_rev,
        viscous_nm_per_rps,
        numbers.delay_s,
        numbers.torque_constant_nm_per_a,
        error_filter_s=error_filter_s(plus),
    )
    margins = loop_margins(
        axis, plus.pi.proportional_a_per_rps, plus.pi.integral_a_per_rev, plus.observer.gain_nm_per_rev
    )
    wish = Wish(phase_margin_deg=margins.phase_deg, gain_margin=margins.gain)
    forms = (
        ObserverForm(DOB_ORDER * (0.0,)),
        ObserverForm(ESO_ORDER * (0.0,)),
        friction_form(plus, numbers, plus.observer.friction),
    )
    return PeerDesign(numbers, margins, *(observer_gains(axis, form, wish) for form in forms))


def friction_form(plus: ControllerConfig, numbers: AxisNumbers, friction: FrictionConfig) -> ObserverForm:
    """Of the friction observer on the position, in sliding, beside the PI of `plus`."""
    return ObserverForm(
        (0.0, further_pole_rad_per_s(friction, numbers.inertia_nm_s2_per_rev)),
        plus.pi.integral_a_per_rev / plus.pi.proportional_a_per_rps,
        numbers.sensor_delay_s,
    )


def with_friction(config: ControllerConfig, friction: FrictionConfig) -> ControllerConfig:
    """A law of this project with another friction model; the bound of its estimate follows."""
    observer = config.observer
    clamp_nm = observer.clamp_nm * friction.static_nm / observer.friction.static_nm
    return config._replace(observer=observer._replace(friction=friction, clamp_nm=clamp_nm))


def tuned_to(
    config: ControllerConfig, design: PeerDesign, axis: AxisNumbers, friction: FrictionConfig
) -> ControllerConfig:
    """A law of this project with the gains, shifts and friction of an axis; shifts that it does not have stay zero."""
    inertia_ratio = axis.inertia_nm_s2_per_rev / design.nominal.inertia_nm_s2_per_rev
    current_ratio = inertia_ratio * design.nominal.torque_constant_nm_per_a / axis.torque_constant_nm_per_a
    faster = design.nominal.delay_s / axis.delay_s
    config = with_friction(config, friction)
    observer = config.observer
    shifts = config.feedforward
    ahead_ticks = (axis.delay_s - axis.sensor_delay_s) / config.period_s
    behind_ticks = axis.sensor_delay_s / config.period_s
    return config._replace(
        pi=PiConfig(
            config.pi.proportional_a_per_rps * current_ratio * faster,
            config.pi.integral_a_per_rev * current_ratio * faster**2,
        ),
        observer=observer._replace(gain_nm_per_rev=observer.gain_nm_per_rev * inertia_ratio * faster**2),
        feedforward=shifts._replace(
            inertia_nm_s2_per_rev=axis.inertia_nm_s2_per_rev if shifts.inertia_nm_s2_per_rev else 0.0,
            ahead_ticks=ahead_ticks if shifts.ahead_ticks else 0.0,
            behind_ticks=behind_ticks if shifts.behind_ticks else 0.0,
        ),
        torque_constant_nm_per_a=axis.torque_constant_nm_per_a,
    )


def laws_of(candidates: Sequence[Candidate], design: PeerDesign, axis: AxisNumbers, models: Models) -> list[PeerLaw]:
    """PI, PI+FFFO, PI+FFFO+ and the peers, tuned to an axis. `candidates` are those of OWN_LAWS."""
    by_name = {candidate.name: candidate for candidate in candidates}
    own = [
        PeerLaw(name, tuned_to(by_name[name].controller, design, axis, models.two_state), by_name[name].toggle)
        for name in OWN_LAWS
    ]
    plus = own[-1].config
    assert isinstance(plus, ControllerConfig)
    return [*own, *peers_of(plus, own[-1].toggle, design, axis, models)]


def peers_of(
    plus: ControllerConfig, toggle: int, design: PeerDesign, axis: AxisNumbers, models: Models
) -> list[PeerLaw]:
    """The published laws with the gains, inertia torque, preview and error filter of PI+FFFO+."""
    gain = plus.observer.gain_nm_per_rev
    peer = PeerConfig(
        plus.pi,
        plus.feedforward,
        plus.torque_constant_nm_per_a,
        plus.current_limit_a,
        plus.period_s,
        plus.error_share,
    )
    integral = plus.pi.integral_a_per_rev + gain / plus.torque_constant_nm_per_a
    learning = peer._replace(pi=plus.pi._replace(integral_a_per_rev=integral))
    in_friction = plus._replace(observer=plus.observer._replace(learns_in_integral=False))
    return [
        PeerLaw("2sep observer+", in_friction, toggle),
        PeerLaw("lugre observer+", LugreConfig(peer, models.lugre, gain)),
        PeerLaw("lugre forward+", LugreConfig(learning, models.lugre, 0.0)),
        PeerLaw("gms forward+", SlipConfig(learning, models.slip)),
        PeerLaw("dob+", _observer_loop(peer, design, axis, design.disturbance, DOB_ORDER)),
        PeerLaw("eso+", _observer_loop(peer, design, axis, design.extended_state, ESO_ORDER)),
        PeerLaw("luenberger+", _luenberger_loop(peer, plus, design, axis, models.two_state)),
    ]


def _observer_loop(
    peer: PeerConfig, design: PeerDesign, axis: AxisNumbers, gains: ObserverGains, order: int
) -> ObserverLoop:
    proportional, bandwidth = _scaled_gains(design, axis, gains)
    return ObserverLoop(
        peer._replace(pi=PiConfig(proportional, 0.0)),
        axis.inertia_nm_s2_per_rev,
        bandwidth,
        order,
        axis.delay_s / peer.period_s,
    )


def _luenberger_loop(
    peer: PeerConfig, plus: ControllerConfig, design: PeerDesign, axis: AxisNumbers, friction: FrictionConfig
) -> LuenbergerLoop:
    """The faster pole follows from the stiffness of this axis's friction, so that the eigenvalues stay real."""
    proportional, slow_rad_per_s = _scaled_gains(design, axis, design.friction_state)
    form = friction_form(plus, axis, friction)
    return LuenbergerLoop(
        peer._replace(pi=PiConfig(proportional, proportional * form.integral_per_s)),
        friction,
        axis.inertia_nm_s2_per_rev,
        slow_rad_per_s,
        slow_rad_per_s + form.beyond_rad_per_s[-1],
        (axis.delay_s - axis.sensor_delay_s) / peer.period_s,
    )


def _scaled_gains(design: PeerDesign, axis: AxisNumbers, gains: ObserverGains) -> tuple[float, float]:
    """Proportional gain (A/rps) and bandwidth (rad/s) on another axis."""
    faster = design.nominal.delay_s / axis.delay_s
    per_torque = design.nominal.torque_constant_nm_per_a / axis.torque_constant_nm_per_a
    inertia_ratio = axis.inertia_nm_s2_per_rev / design.nominal.inertia_nm_s2_per_rev
    return gains.proportional_a_per_rps * inertia_ratio * per_torque * faster, gains.bandwidth_rad_per_s * faster
