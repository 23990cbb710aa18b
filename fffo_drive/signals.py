"""The row: what is recorded of one tick. Every list of fields in the package is generated from `SIGNALS`.

The ring buffer, the MCAP schema, the reader's columns, the live view and the signal table come from here. Fields are in
descending order of size, so that the NumPy dtype and the CDR encoding of the row are the same bytes, without padding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Signal(NamedTuple):
    """One field of the row."""

    name: str
    dtype: str  # NumPy type string, little-endian
    unit: str  # "-" for a number without one
    meaning: str


SIGNALS: tuple[Signal, ...] = (
    Signal("tick", "<u8", "-", "number of the control period since the loop began; skipped periods have no row"),
    Signal("deadline_ns", "<i8", "ns", "CLOCK_MONOTONIC time at which the tick was due"),
    Signal("lateness_ns", "<i8", "ns", "how long after the deadline the loop woke"),
    Signal("turnaround_ns", "<i8", "ns", "from SYNC sent to feedback received; -1 if none arrived before the cut-off"),
    Signal("busy_ns", "<i8", "ns", "from waking to command sent"),
    Signal("heartbeat_age_ns", "<i8", "ns", "age of the drive's last heartbeat; -1 before the first"),
    Signal("foreign_id", "<i8", "-", "COB-ID of the first frame that somebody else sent for us or the drive; -1: none"),
    Signal("reference_rps", "<f8", "rps", "velocity reference at the deadline"),
    Signal("reference_rps2", "<f8", "rps2", "its time derivative"),
    Signal("reference_ahead_rps", "<f8", "rps", "reference read ahead, on which feed-forward torque is computed"),
    Signal("reference_ahead_rps2", "<f8", "rps2", "its time derivative"),
    Signal("expected_rps", "<f8", "rps", "reference as old as the feedback, from which the error is computed"),
    Signal("velocity_rps", "<f8", "rps", "velocity feedback of the drive; the error uses it or estimated_rps"),
    Signal("position_rev", "<f8", "rev", "position feedback, multi-turn"),
    Signal("current_a", "<f8", "A", "torque-forming current as the drive reports it (age: status_age)"),
    Signal("error_rps", "<f8", "rps", "expected_rps minus velocity_rps, or minus estimated_rps, as flags says"),
    Signal("filtered_error_rps", "<f8", "rps", "the error behind notches and low-pass: input of the control law"),
    Signal("proportional_a", "<f8", "A", "proportional term of the PI controller"),
    Signal("integral_a", "<f8", "A", "integral term of the PI controller"),
    Signal("hold_a", "<f8", "A", "current that holds the position at rest"),
    Signal("friction_nm", "<f8", "Nm", "friction estimate F of the observer, injected through 1/Kt"),
    Signal("inertia_nm", "<f8", "Nm", "inertia torque of the reference, injected through 1/Kt"),
    Signal("effects_nm", "<f8", "Nm", "compensation of the effects in service, injected through 1/Kt"),
    Signal("observation_nm_per_s", "<f8", "Nm/s", "lambda(e), the part of dF/dt that the control error drives"),
    Signal("requested_a", "<f8", "A", "sum of all terms, before the controller's limit and the envelope"),
    Signal("limited_a", "<f8", "A", "current passed by the envelope, before quantisation"),
    Signal("current_command_a", "<f8", "A", "command on the bus, quantised; acts at the next SYNC"),
    Signal("i2t_a2s", "<f8", "A2s", "I2t: heat above the continuous current, after this command"),
    Signal("set_point_rps", "<f8", "rps", "live set point in force, which the reference approaches; 0 without one"),
    Signal("true_velocity_rps", "<f8", "rps", "shaft velocity (simulated drive in process only, else NaN)"),
    Signal("true_friction_nm", "<f8", "Nm", "friction torque of the plant (simulated drive in process only, else NaN)"),
    Signal("estimated_rps", "<f8", "rps", "velocity from position and torque; 0 where it is not estimated"),
    Signal("disturbance_nm", "<f8", "Nm", "disturbance torque, as estimated with the velocity"),
    Signal("adapted_nm", "<f8", "Nm", "torque of the adaptation, injected through 1/Kt"),
    Signal("adapted_offset_nm", "<f8", "Nm", "adapted constant torque"),
    Signal("adapted_coulomb_nm", "<f8", "Nm", "adapted change of Coulomb friction"),
    Signal("adapted_viscous_nm_per_rps", "<f8", "Nm/rps", "adapted change of viscous friction"),
    Signal("velocity_age", "<u4", "ticks", "periods since the velocity was fresh; 0: answer to this SYNC"),
    Signal("status_age", "<u4", "ticks", "periods since statusword and current were fresh"),
    Signal("row_number", "<u4", "-", "number of the row since the session began; a missing number is a lost row"),
    Signal("request_number", "<u4", "-", "sequence number of the last record seen when the tick began"),
    Signal("parameters_number", "<u4", "-", "record of the controller's parameters in use"),
    Signal("effects_number", "<u4", "-", "record of the table of effects in use"),
    Signal("profile_number", "<u4", "-", "record of the present or last profile"),
    Signal("set_point_number", "<u4", "-", "record of the live set point taken last"),
    Signal("set_point_sample", "<i4", "-", "ticks since the motion by live set points began; -1 without one"),
    Signal("profile_sample", "<i4", "-", "index into the running profile; -1 without one"),
    Signal("statusword", "<u2", "-", "CiA 402 statusword 0x6041"),
    Signal("controlword", "<u2", "-", "CiA 402 controlword 0x6040 sent with the command"),
    Signal("limits", "<u2", "-", "active limits of the command: bits of control.envelope.LIMIT_*"),
    Signal("trip", "<u2", "-", "latched fault of the envelope or the loop: control.envelope.TRIP_*"),
    Signal("flags", "<u2", "-", "conditions at the start of the tick: bits of runtime.tick.FLAG_*"),
    Signal("toggle", "u1", "-", "friction computed from: 0 off, 1 reference (FF), 2 measured velocity (FB)"),
    Signal("mode", "u1", "-", "0 no torque, 1 velocity loop closed, 2 open-loop current"),
    Signal("late", "u1", "-", "1 if the tick woke later than the configured share of the period"),
    Signal("effects", "u1", "-", "effects in service: bits, in the order in which they are compensated"),
    Signal("goal", "u1", "-", "goal for the drive, before the reaction to a fault: drive.cia402.GOAL_*"),
    Signal("resetting", "u1", "ticks", "remaining duration of a fault reset, including this tick"),
)

# in logs of other programs only: no drive of this program reports it
REFERENCE_POSITION = Signal("reference_position_rev", "<f8", "rev", "position by a reference encoder on the same shaft")
MEASURED_TORQUE = Signal("measured_torque_nm", "<f8", "Nm", "by a torque sensor between motor and load")
TEMPERATURE = Signal("temperature_degc", "<f8", "degC", "of the motor, or where friction is; what the log has")

ROW = np.dtype([(signal.name, signal.dtype) for signal in SIGNALS])
UNITS = {signal.name: signal.unit for signal in SIGNALS}
