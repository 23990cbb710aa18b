"""What a file must satisfy beyond each key: stability of the law, a profile inside its limits, room on the bus."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from ..can.load import Chain, Load
from ..control.own_law import ControlLaw, LawInput
from ..control.own_law_margins import own_law_margins
from ..control.reference import MODE_CURRENT, MODE_VELOCITY, Profile, profile_bounds
from ..control.stability import (
    RIGID,
    Margins,
    condition_14_nm_per_rev,
    loop_delay_s,
    loop_margins,
    stuck_axes,
    worst_margins,
)
from ..control.velocity_estimator import velocity_noise_rps
from ..documents import refuse, refuse_argument
from ..drive.canopen.config import HOST_S, ONE_MASTER, chain_of, load_of
from ..drive.canopen.current_limit import MAX_TORQUE, least_limit
from ..drive.canopen.object_map import MappingError
from ..drive.canopen.silence import LIFE_GUARDING
from ..drive.port import CurrentLimit, limit_words
from ..identification.excitation import predict_motion
from ..identification.tuning import resonance_text
from ..model.parameters import ModelFile
from ..units import NS_PER_S
from .axis import AxisFile, controller_config, hold_dead_band_rev, loop_axis
from .drive_section import CanopenDriveSection
from .resolution import resolution_of
from .sections import EnvelopeSection, VelocitySection

# of the loop's rate: where 2 pi bandwidth / rate is above 1.3 the estimate takes the position's noise as it comes
FASTEST_ESTIMATE_SHARE = 0.2
COARSE_CURRENT_SHARE = 0.05  # of the continuous current: noise that one count of the position makes in the command
FALLBACK_PHASE_DEG, FALLBACK_GAIN = 15.0, 1.3  # with the drive's velocity, until the estimate has settled again


def law_margins(axis: AxisFile, model: ModelFile, observer_on: bool) -> Margins:
    """Margins of the loop of this file on its model, at the smallest damping: the viscous one."""
    section = axis.controller
    gain = section.observer.gain_nm_per_rev if observer_on else 0.0
    return loop_margins(
        loop_axis(axis, model),
        section.proportional_a_per_rps,
        section.integral_a_per_rev,
        gain,
    )


def own_margins(axis: AxisFile, model: ModelFile, law: ControlLaw, speed_rps: float) -> Margins:
    """Margins of a user's law on the axis of this file, at one speed. It gets the error without filter and notches."""
    config = controller_config(axis, model)
    seen = LawInput(
        config.period_s,
        speed_rps,
        0.0,
        speed_rps,
        0.0,
        speed_rps,
        speed_rps,
        0.0,
        0.0,
        0.0,
        config.torque_constant_nm_per_a,
        config.current_limit_a,
        False,
    )
    loop = loop_axis(axis, model)._replace(error_filter_s=0.0, notches=(), estimator=None)
    return own_law_margins(law, loop, seen)


def _delay_ms(axis: AxisFile, model: ModelFile) -> float:
    """Without the hold, as a model has it; shorter where the velocity is estimated."""
    period_s = axis.loop.period_s
    return round(1e3 * (loop_delay_s(model, period_s, axis.controller.velocity.estimated) - 0.5 * period_s), 6)


def rest_margins(axis: AxisFile, model: ModelFile) -> Margins:
    """Margins at rest, where the contact sticks and the gains are those at rest."""
    section = axis.controller
    return worst_margins(
        loop_margins(
            stuck,
            section.at_rest.gain_share * section.proportional_a_per_rps,
            section.at_rest.gain_share * section.integral_a_per_rev,
            0.0,
            section.at_rest.hold_a_per_rev_s,
        )
        for stuck in stuck_axes(loop_axis(axis, model), model, hold_dead_band_rev(axis))
    )


def velocity_problems(axis: AxisFile, model: ModelFile) -> list[str]:
    """What an estimated velocity lacks: a known lag to give back, time in a period, a position that is fine enough.

    The position itself is never missing: it comes with the velocity, in one PDO (drive.canopen.object_map).
    """
    section = axis.controller.velocity
    if not section.estimated:
        return []
    sensor_s, delay_s = model.sensor_delay_s.value, model.delay_s.value
    if not 0.0 < sensor_s <= delay_s:
        return [
            f"controller.velocity.source: estimated compensates the model's sensor_delay_s, which is {sensor_s:g} s of "
            f"delay_s {delay_s:g} s: `fffo-drive identify` measures it; without a lag `drive` is as good"
        ]
    highest_hz = FASTEST_ESTIMATE_SHARE * axis.loop.rate_hz
    if section.bandwidth_hz > highest_hz:
        return [
            f"controller.velocity.bandwidth_hz: {section.bandwidth_hz:g} is more than {highest_hz:g} Hz, "
            f"{FASTEST_ESTIMATE_SHARE:g} of loop.rate_hz: lower it or raise the rate"
        ]
    one = resolution_of(axis, model)
    if one is None:
        return []
    noise_rps = velocity_noise_rps(section.bandwidth_hz, one.position_rev / math.sqrt(12.0), axis.loop.period_s)
    noise_a = axis.controller.proportional_a_per_rps * noise_rps
    if noise_a > COARSE_CURRENT_SHARE * axis.envelope.continuous_current_a:
        return [
            f"controller.velocity.bandwidth_hz: one count of 0x6064 is {one.position_rev:.3g} rev, which makes "
            f"{noise_rps:.3g} rps of noise and {noise_a:.3g} A in the command: lower it, or estimate from a finer "
            "position feedback (drive.counts_per_rev)"
        ]
    return []


def fallback_problems(axis: AxisFile, model: ModelFile, observer_on: bool) -> list[str]:
    """Until an estimate has settled the error takes the drive's velocity: these gains must be stable there too."""
    if not axis.controller.velocity.estimated:
        return []
    controller = axis.controller.model_copy(update={"velocity": VelocitySection()})
    fallback = axis.model_copy(update={"controller": controller})
    moving, resting = law_margins(fallback, model, observer_on), rest_margins(fallback, model)
    problems = []
    for place, margins, least_deg, least_gain in (
        ("", moving, FALLBACK_PHASE_DEG, FALLBACK_GAIN),
        (" at rest", resting, 0.0, 1.0),
    ):
        if margins.phase_deg < least_deg or margins.gain < least_gain:
            problems.append(
                "controller.velocity.source: if the estimate is lost, the error uses the drive's velocity, and with "
                f"it the margins{place} are {margins.phase_deg:.1f} deg and {margins.gain:.2f}: below "
                f"{least_deg:g} deg or {least_gain:g}. Lower proportional_a_per_rps"
            )
    return problems


def law_problems(axis: AxisFile, model: ModelFile, observer_on: bool) -> list[str]:
    """What speaks against this law: condition (14) (with the observer on), phase and gain margin with the delay."""
    section = axis.controller
    problems = velocity_problems(axis, model)
    if problems:
        return problems
    if observer_on and section.observer.learns_in == "friction":
        excess = condition_14_nm_per_rev(
            section.integral_a_per_rev,
            model.torque_constant_nm_per_a,
            section.observer.gain_nm_per_rev,
            model.friction.attraction_nm_per_rev.value,
        )
        if excess < 0:
            needed = section.observer.gain_nm_per_rev - excess
            problems.append(
                f"controller.observer.gain_nm_per_rev: {section.observer.gain_nm_per_rev:g} breaks condition (14), "
                f"Ki Kt + L >= 2 B: at least {needed:.3g} Nm/rev is needed with this integral gain"
            )
    margins = law_margins(axis, model, observer_on)
    loop = loop_axis(axis, model)
    tune = f"`fffo-drive tune {axis.model} --axis AXIS --out DIR`"  # for the model as it is, be it assumed
    remedy = f", or let {tune} choose the gains"
    if loop.elastic != RIGID:
        remedy = f". With {resonance_text(loop)}: {tune} chooses a notch"
    ends = loop.inertia_range_nm_s2_per_rev
    loads = "" if ends is None else f", at the worst inertia from {model.inertia_text(*ends)},"
    if margins.phase_deg < section.phase_margin_deg:
        problems.append(
            f"controller: phase margin {margins.phase_deg:.1f} deg with {_delay_ms(axis, model):g} ms delay{loads} is "
            f"below phase_margin_deg {section.phase_margin_deg:g}: lower observer.gain_nm_per_rev, "
            f"integral_a_per_rev or proportional_a_per_rps{remedy}"
        )
    if margins.gain < section.gain_margin:
        problems.append(
            f"controller: gain margin {margins.gain:.2f}{loads} is below gain_margin {section.gain_margin:g}: lower "
            f"proportional_a_per_rps{remedy}"
        )
    problems += fallback_problems(axis, model, observer_on)
    at_rest = rest_margins(axis, model)
    if at_rest.phase_deg < 0.0 or at_rest.gain < 1.0:
        problems.append(
            f"controller.at_rest.gain_share: {section.at_rest.gain_share:g} leaves a phase margin of "
            f"{at_rest.phase_deg:.1f} deg and a gain margin of {at_rest.gain:.2f} at rest, where the friction contact "
            "acts as a spring: the axis would oscillate. Lower it, or at_rest.hold_a_per_rev_s, or let "
            f"{tune} choose both"
        )
    return problems


def profile_problems(axis: AxisFile, profile: Profile) -> list[str]:
    """What of a profile the envelope would not let pass."""
    bounds = profile_bounds(profile)
    limits = axis.envelope
    problems = []
    if profile.mode == MODE_VELOCITY:
        if bounds.value > limits.speed_limit_rps:
            problems.append(
                f"profile: peak of {bounds.value:.4g} rps is beyond envelope.speed_limit_rps {limits.speed_limit_rps:g}"
            )
        window = limits.position_window_rev
        if window is not None and bounds.travel > max(-window[0], window[1]):
            problems.append(
                f"profile: travels {bounds.travel:.4g} rev from its start, envelope.position_window_rev is {window}"
            )
    elif bounds.value > limits.current_limit_a:
        problems.append(
            f"profile: peak of {bounds.value:.4g} A is beyond envelope.current_limit_a {limits.current_limit_a:g}"
        )
    return problems


def bus_sum(axis: AxisFile, model: ModelFile) -> tuple[Load, Chain]:
    """Load of the bus, and the chain inside one period, for a drive on a bus. Raises MappingError."""
    section = axis.drive
    assert isinstance(section, CanopenDriveSection)
    config = section.drive_config(model.torque_constant_nm_per_a, NS_PER_S // axis.loop.rate_hz)
    return load_of(config), chain_of(config, section.turnaround_us * 1e-6, HOST_S)


def bus_problems(axis: AxisFile, model: ModelFile) -> list[str]:
    """What does not fit on the bus even when nothing is in the way."""
    if not isinstance(axis.drive, CanopenDriveSection):
        return []
    try:
        load, chain = bus_sum(axis, model)
    except MappingError as error:  # it lists the keys of this section
        return [f"drive: {error}; the period is 1 / loop.rate_hz" if "period" in str(error) else f"drive: {error}"]
    problems = silence_problems(axis.drive, axis.envelope)
    highest_hz = axis.drive.highest_rate_hz
    if highest_hz is not None and axis.loop.rate_hz > highest_hz:
        problems.append(
            f"loop.rate_hz: {axis.loop.rate_hz} Hz; the drive accepts commands at no more than {highest_hz} Hz "
            "(drive.highest_rate_hz, or its profile)"
        )
    if load.worst > 1.0:
        problems.append(
            f"loop.rate_hz: {axis.loop.rate_hz} Hz loads the bus to {load.worst:.0%} at drive.bitrate_hz "
            f"{axis.drive.bitrate_hz}: lower the rate or raise the bit rate"
        )
    elif chain.typical_s > chain.period_s:
        problems.append(
            f"loop.rate_hz: SYNC, feedback and command take {chain.typical_s * 1e6:.0f} us of a period of "
            f"{chain.period_s * 1e6:.0f} us: lower the rate; `fffo-drive config check` prints the sum"
        )
    return problems


def silence_problems(drive: CanopenDriveSection, limits: EnvelopeSection) -> list[str]:
    """Limits of the drive's silence that are shorter than the time between two of its messages."""
    problems = []
    if drive.status_every >= limits.status_missing_ticks:
        problems.append(
            f"envelope.status_missing_ticks: {limits.status_missing_ticks} SYNCs, but the statusword comes with every "
            f"{drive.status_every}th (drive.status_every): raise one or lower the other"
        )
    guarded = drive.silence_detection == LIFE_GUARDING  # the drive answers our requests
    key = "heartbeat_ms" if guarded else "drive_heartbeat_ms"
    sent_s = getattr(drive, key) / 1e3
    if 0.0 < limits.heartbeat_timeout_s <= sent_s:
        problems.append(
            f"envelope.heartbeat_timeout_s: {limits.heartbeat_timeout_s:g} s, but the drive's heartbeat comes every "
            f"{sent_s:g} s (drive.{key}): raise one or lower the other"
        )
    return problems


def shared_buses(axes: Sequence[tuple[str, AxisFile]]) -> list[str]:
    """Of files and their axes: which have different nodes on one bus. One of them at a time can be commanded."""
    on_bus: dict[str, dict[int, str]] = {}
    for path, axis in axes:
        if isinstance(axis.drive, CanopenDriveSection):
            on_bus.setdefault(axis.drive.bus, {})[axis.drive.node_id] = path
    return [
        f"{bus} is the bus of {' and '.join(nodes.values())}: {ONE_MASTER}"
        for bus, nodes in on_bus.items()
        if len(nodes) > 1
    ]


def motion_problems(axis: AxisFile, profile: Profile, model: ModelFile) -> list[str]:
    """What an open-loop current would do beyond the envelope, on the believed axis, before anything moves."""
    if profile.mode != MODE_CURRENT:
        return []
    forecast = predict_motion(profile, model.axis_config())
    limits = axis.envelope
    problems = []
    if forecast.speed_rps > limits.speed_limit_rps:
        problems.append(
            f"profile: according to the model this current drives the axis to {forecast.speed_rps:.4g} rps, beyond "
            f"envelope.speed_limit_rps {limits.speed_limit_rps:g}: lower its amplitude"
        )
    window = limits.position_window_rev
    if window is not None and not window[0] <= forecast.lowest_rev <= forecast.highest_rev <= window[1]:
        problems.append(
            f"profile: according to the model this current moves the axis from {forecast.lowest_rev:.4g} to "
            f"{forecast.highest_rev:.4g} rev, "
            f"beyond envelope.position_window_rev {window}: lower its amplitude, raise its lowest frequency"
        )
    return problems


def drive_limit_words(axis: AxisFile, model: ModelFile) -> list[str]:
    """Of a law whose current limit is above the one that this file gives the drive."""
    section = axis.drive
    if not isinstance(section, CanopenDriveSection):
        return []
    written = {entry.object: entry.value for entry in section.sdo if entry.sub == 0 and entry.when != "after_disable"}
    if section.max_torque_permille is not None:
        written[MAX_TORQUE] = section.max_torque_permille
    limit = least_limit(written.get, model.torque_constant_nm_per_a, section.rated_torque_nm, section.rated_current_a)
    if section.current_limit_a is not None:
        limit = CurrentLimit(section.current_limit_a, "drive.current_limit_a")
    return limit_words(axis.controller.current_limit_a, limit)


def require(path: str | Path, problems: list[str], argument: str | None = None) -> None:
    """Raise DocumentError with one line for each problem, if there is one. Each begins with the key concerned.

    `argument`: the name of what was given in place of the file.
    """
    parts = [problem.partition(": ") for problem in problems]
    pairs = [(key, text) for key, _, text in parts]
    if argument is not None:
        refuse_argument(argument, pairs)
    refuse(path, pairs)
