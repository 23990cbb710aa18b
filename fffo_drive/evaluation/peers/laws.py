"""The laws of a comparison on one axis: this project's and its peers, with the same margins.

Laws with a friction model, and the plain ones, have the gains of PI+FFFO+: their linear loop is the same PI plus L / s,
wherever L is added. Those with a disturbance observer have the gains of `design.observer_gains` for the same margins,
and a velocity loop in the drive those of `drive_loop.drive_gains`. The friction models are fitted to one record of the
same plant; then all are changed by the same share.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np

from ...arrays import Floats
from ...control.controller import ControllerConfig
from ...control.feedforward import NO_FEEDFORWARD
from ...control.friction_observer import TOGGLE_OFF
from ...control.pi import PiConfig
from ...control.stability import LinearAxis, loop_margins
from ...drive.simulated.parameters import PlantConfig, delay_budget
from ...identification.tuning import Wish
from ...model.friction import FrictionConfig
from ...units import inertia_nm_s2_per_rev
from .constants import PeerConfig
from .design import ObserverForm, ObserverGains, observer_gains
from .disturbance_observer import ObserverLoop
from .drive_loop import DELAYS_S, PER_TICK, TORQUE_RATES_HZ, DriveLoop, TorqueOffset, drive_gains
from .fit import LUGRE_START, SLIP_START, TABLE_1, TwoSurfaces, fit_friction
from .loop import PeerLaw
from .luenberger import LuenbergerLoop, further_pole_rad_per_s
from .lugre import LugreConfig, LugreModel
from .maxwell_slip import SlipConfig, SlipModel

Model = TypeVar("Model", FrictionConfig, TwoSurfaces, LugreModel, SlipModel)
Contact = TypeVar("Contact", FrictionConfig, TwoSurfaces)

PI, FFFO, PLUS = "pi", "pi+fffo", "pi+fffo+"
OWN_LAWS = (PI, FFFO, PLUS)
PI_ALL, PI_AHEAD = "pi, all integral", "pi+inertia+preview"  # without a friction model
PLAIN_LAWS = (PI_ALL, PI_AHEAD)
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
    """Gains of the observers on an axis, and the margins that all laws have there."""

    wish: Wish
    disturbance: ObserverGains  # Q of first order
    extended_state: ObserverGains  # Q of second order
    friction_state: ObserverGains  # friction observer on the position


def drives_own(delay_s: float, torque_rate_hz: float | None = None) -> str:
    """Name of a velocity loop in the drive, alone or with the torque of the PC."""
    own = f"drive {1e3 * delay_s:g} ms"
    return own if torque_rate_hz is None else f"{own} + torque {torque_rate_hz:g} Hz"


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


def design_for(plus: ControllerConfig, wish: Wish | None = None) -> PeerDesign:
    """Gains of all observers on the axis that PI+FFFO+ knows. ValueError: none has the margins.

    None: the margins of PI+FFFO+ there.
    """
    numbers, friction = known_numbers(plus), plus.observer.friction
    axis = LinearAxis(
        numbers.inertia_nm_s2_per_rev,
        friction.viscous_nm_per_rps,
        numbers.delay_s,
        numbers.torque_constant_nm_per_a,
        error_filter_s=error_filter_s(plus),
    )
    if wish is None:
        margins = loop_margins(axis, *plus.pi, plus.observer.gain_nm_per_rev)
        wish = Wish(phase_margin_deg=margins.phase_deg, gain_margin=margins.gain)
    forms = (ObserverForm(DOB_ORDER * (0.0,)), ObserverForm(ESO_ORDER * (0.0,)), friction_form(plus, numbers, friction))
    return PeerDesign(wish, *(observer_gains(axis, form, wish) for form in forms))


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


def plain_laws(plus: ControllerConfig) -> list[PeerLaw]:
    """PI+FFFO+ without its friction model, L in the integral: with nothing from the reference, and with the rest."""
    ahead = plus._replace(pi=_learning(plus))
    return [
        PeerLaw(PI_ALL, ahead._replace(feedforward=NO_FEEDFORWARD), TOGGLE_OFF),
        PeerLaw(PI_AHEAD, ahead, TOGGLE_OFF),
    ]


def drive_loops(plus: ControllerConfig, wish: Wish, friction: FrictionConfig) -> list[PeerLaw]:
    """The drive's own velocity loop at each of `DELAYS_S`, alone and with the torque of the PC at each of its rates."""
    axis = known_numbers(plus)
    inertia, constant = axis.inertia_nm_s2_per_rev, axis.torque_constant_nm_per_a
    found = []
    for delay_s in DELAYS_S:
        gains = PiConfig(*drive_gains(inertia, constant, delay_s, wish))
        config = PeerConfig(gains, NO_FEEDFORWARD, constant, plus.current_limit_a, plus.period_s / PER_TICK, 1.0)
        found.append(PeerLaw(drives_own(delay_s), config, drive=DriveLoop(delay_s)))
        for rate_hz in TORQUE_RATES_HZ:
            beside = DriveLoop(delay_s, TorqueOffset(friction, inertia, rate_hz))
            found.append(PeerLaw(drives_own(delay_s, rate_hz), config, drive=beside))
    return found


def peers_of(plus: ControllerConfig, toggle: int, design: PeerDesign, models: Models) -> list[PeerLaw]:
    """The plain laws, the published ones and the drive's own loop on the axis that PI+FFFO+ knows.

    All but the last with the gains, inertia torque, preview and error filter of PI+FFFO+, and with its margins.
    """
    gain = plus.observer.gain_nm_per_rev
    peer = PeerConfig(
        plus.pi,
        plus.feedforward,
        plus.torque_constant_nm_per_a,
        plus.current_limit_a,
        plus.period_s,
        plus.error_share,
    )
    learning = peer._replace(pi=_learning(plus))
    in_friction = plus._replace(observer=plus.observer._replace(learns_in_integral=False))
    return [
        *plain_laws(plus),
        PeerLaw("2sep observer+", in_friction, toggle),
        PeerLaw("lugre observer+", LugreConfig(peer, models.lugre, gain)),
        PeerLaw("lugre forward+", LugreConfig(learning, models.lugre, 0.0)),
        PeerLaw("gms forward+", SlipConfig(learning, models.slip)),
        PeerLaw("dob+", _observer_loop(peer, plus, design.disturbance, DOB_ORDER)),
        PeerLaw("eso+", _observer_loop(peer, plus, design.extended_state, ESO_ORDER)),
        PeerLaw("luenberger+", _luenberger_loop(peer, plus, design.friction_state)),
        *drive_loops(plus, design.wish, models.two_state),
    ]


def _learning(plus: ControllerConfig) -> PiConfig:
    """Its PI with L in the integral."""
    more = plus.observer.gain_nm_per_rev / plus.torque_constant_nm_per_a
    return plus.pi._replace(integral_a_per_rev=plus.pi.integral_a_per_rev + more)


def _observer_loop(peer: PeerConfig, plus: ControllerConfig, gains: ObserverGains, order: int) -> ObserverLoop:
    axis = known_numbers(plus)
    return ObserverLoop(
        peer._replace(pi=PiConfig(gains.proportional_a_per_rps, 0.0)),
        axis.inertia_nm_s2_per_rev,
        gains.bandwidth_rad_per_s,
        order,
        axis.delay_s / peer.period_s,
    )


def _luenberger_loop(peer: PeerConfig, plus: ControllerConfig, gains: ObserverGains) -> LuenbergerLoop:
    axis, friction = known_numbers(plus), plus.observer.friction
    form = friction_form(plus, axis, friction)
    proportional, slow_rad_per_s = gains.proportional_a_per_rps, gains.bandwidth_rad_per_s
    return LuenbergerLoop(
        peer._replace(pi=PiConfig(proportional, proportional * form.integral_per_s)),
        friction,
        axis.inertia_nm_s2_per_rev,
        slow_rad_per_s,
        slow_rad_per_s + form.beyond_rad_per_s[-1],
        (axis.delay_s - axis.sensor_delay_s) / peer.period_s,
    )
