"""What PI+FFFO+ does not have by default: the velocity estimated from position and torque, and a second surface.

Both are the controller's own parts (control.velocity_estimator, control.compensation); the margins stay those of
PI+FFFO+ on the drive's velocity. The estimate is given to published laws of the same loop too.
"""

from __future__ import annotations

from typing import Any

from ...control.compensation import Limits, pack_compensation
from ...control.controller import ControllerConfig
from ...control.pi import PiConfig
from ...control.stability import LinearAxis, loop_margins
from ...control.velocity_estimator import estimator_config
from ...identification.tuning import Wish, largest_that
from ...model.axis import AxisConfig
from ...model.effects.laws.second_surface import SECOND_SURFACE
from ...model.effects.table import Term
from .fit import TwoSurfaces
from .laws import AxisNumbers, with_friction
from .loop import PeerLaw
from .lugre import LugreConfig
from .maxwell_slip import SlipConfig

LARGEST_SPEEDUP = 4.0  # of the loop on the estimated velocity


def on_the_estimate(
    law: PeerLaw, wish: Wish, axis: AxisNumbers, bandwidth_hz: float, limits_rps: tuple[float, float]
) -> PeerLaw:
    """A law with the gains of PI+FFFO+, tuned to an axis, on the estimated velocity: without the lag of the drive's.

    The same margins: all frequencies of the loop rise by one factor, Kp by it, Ki and L by its square. The estimate is
    smooth, so the error has no filter. `limits_rps`: the envelope's speed limit and following error. Raises TypeError
    for a law with another loop.
    """
    config = law.config
    if not isinstance(config, ControllerConfig | LugreConfig | SlipConfig):
        raise TypeError(f"{law.name} has an observer of its own in the loop")
    common = config if isinstance(config, ControllerConfig) else config.peer
    gain = config.observer.gain_nm_per_rev if isinstance(config, ControllerConfig) else 0.0  # of peers: in the integral
    delay_s = axis.delay_s - axis.sensor_delay_s
    estimator = estimator_config(
        bandwidth_hz, axis.inertia_nm_s2_per_rev, axis.torque_constant_nm_per_a, delay_s - 0.5 * common.period_s,
        common.period_s, *limits_rps,
    )  # fmt: skip
    linear = LinearAxis(axis.inertia_nm_s2_per_rev, 0.0, delay_s, axis.torque_constant_nm_per_a, estimator=estimator)
    proportional, integral = common.pi

    def holds(faster: float) -> bool:
        squared = faster * faster
        return wish.is_met(loop_margins(linear, faster * proportional, squared * integral, squared * gain))

    faster = largest_that(LARGEST_SPEEDUP, holds)
    squared = faster * faster
    changes: dict[str, Any] = {
        "pi": PiConfig(faster * proportional, squared * integral),
        "feedforward": common.feedforward._replace(behind_ticks=0.0),
        "error_share": 1.0,
        "velocity": estimator,
    }
    if isinstance(config, ControllerConfig):
        observer = config.observer._replace(gain_nm_per_rev=squared * gain)
        return law._replace(config=config._replace(observer=observer, **changes))
    return law._replace(config=config._replace(peer=config.peer._replace(**changes)))


def with_second_surface(law: PeerLaw, axis: AxisNumbers, model: TwoSurfaces) -> PeerLaw:
    """A law of this project with the friction of two surfaces: its own model, and an effect in service."""
    assert isinstance(law.config, ControllerConfig)
    config = with_friction(law.config, model.first)
    known = AxisConfig(axis.inertia_nm_s2_per_rev, axis.torque_constant_nm_per_a, axis.delay_s, model.first)
    most_nm = config.current_limit_a * axis.torque_constant_nm_per_a
    effects = pack_compensation(
        [Term(SECOND_SURFACE, model.second)], known, axis.delay_s - axis.sensor_delay_s, Limits(most_nm, most_nm),
        config.period_s,
    )  # fmt: skip
    return law._replace(config=config, effects=effects)
