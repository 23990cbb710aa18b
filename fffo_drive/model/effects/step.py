"""The axis with effects as one step: J dw/dt = u - F(w) - E."""

from __future__ import annotations

from ...jit import njit
from ..axis import AxisConfig, AxisState
from ..friction import friction_step
from . import slots as s
from .table import EffectTable, effects_step


@njit
def loaded_step(
    config: AxisConfig, table: EffectTable, state: AxisState, current_a: float, offset_nm: float
) -> AxisState:
    """The axis after one step of the table under a constant current. `offset_nm` opposes the motor's torque.

    The leapfrog of `axis_step`; effects act at the middle of the step with the speed of the drift, and are in the
    table's signals afterwards. The first half-kick uses the effects of the previous step and is corrected at the end.
    """
    signals = table.signals
    step_s = signals[s.STEP_S]
    half_kick = 0.5 * step_s / config.inertia_nm_s2_per_rev
    torque_nm = config.torque_constant_nm_per_a * current_a - offset_nm
    before_nm = state.friction.torque_nm
    load_nm = signals[s.LOAD_NM]
    drift_rps = state.velocity_rps + half_kick * (torque_nm - before_nm - load_nm)
    friction = friction_step(config.friction, state.friction, drift_rps, 0.0, step_s)
    signals[s.VELOCITY_RPS] = drift_rps
    signals[s.ACCELERATION_RPS2] = (torque_nm - friction.torque_nm - load_nm) / config.inertia_nm_s2_per_rev
    signals[s.MOTOR_ANGLE_REV] = state.position_rev + 0.5 * drift_rps * step_s
    position_rev = state.position_rev + drift_rps * step_s
    signals[s.SENSOR_ANGLE_REV] = position_rev
    signals[s.CURRENT_A] = current_a
    signals[s.FRICTION_NM] = friction.torque_nm
    signals[s.TRAVEL_REV] = friction.travel_rev
    signals[s.DIRECTION] = friction.direction
    effects_step(table)
    signals[s.TIME_S] += step_s
    whole_nm = 2.0 * torque_nm - before_nm - friction.torque_nm - 2.0 * signals[s.LOAD_NM]
    return AxisState(state.velocity_rps + half_kick * whole_nm, position_rev, friction)
