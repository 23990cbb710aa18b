"""What keeps a drive from Operation Enabled, in plain words, from its objects (CiA 402-2, CiA 301).

A failure prevents it. A warning may prevent it, or cause trouble later. Nothing here moves the drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..drive.canopen.emergency import code_text, emergency_text, history_text, register_text
from ..drive.canopen.sdo_objects import SdoObjects
from ..drive.canopen.service import Emergency
from ..drive.cia402 import (
    STATE_FAULT,
    STATE_FAULT_REACTION_ACTIVE,
    STATE_NOT_READY,
    STATE_OPERATION_ENABLED,
    STATE_QUICK_STOP_ACTIVE,
    STATE_UNKNOWN,
    STATUS_REMOTE,
    STATUS_VOLTAGE_ENABLED,
    STATUS_WARNING,
    state_name,
    state_of,
)
from ..system.findings import HostFinding, Severity, failure, ok, warning

INPUT_NEGATIVE_LIMIT, INPUT_POSITIVE_LIMIT, INPUT_INTERLOCK = 1 << 0, 1 << 1, 1 << 3  # 0x60FD
OUTPUT_BRAKE = 1 << 0  # 0x60FE:01
LOWEST_DC_LINK_V = 10.0  # below: the logic is supplied and the power stage is not
LOWEST_TORQUE_LIMIT = 1000  # 0x6072, thousandths of the rated torque
TORQUE_LIMIT_PERMILLE = 1000.0
COARSE_SHARE = 0.1  # of the observer's feedback band: a coarser count of 0x606C gives a warning
FAULT_STATES = (STATE_FAULT, STATE_FAULT_REACTION_ACTIVE)
HISTORY = 3  # entries of 0x1003 that are reported


def stands_between(
    objects: SdoObjects,
    emergencies: Sequence[Emergency],
    operational: bool,
    written: Sequence[str] = (),
    reset_command: str = "fffo-drive bring-up BUS --reset-fault",
) -> list[HostFinding]:
    """All findings, in the order in which they should be mended.

    `operational`: the drive was in NMT OPERATIONAL when its state was read. `written`: objects that the axis file
    writes before the drive is enabled (0x6076:00). `reset_command`: clears a fault.
    """
    word = objects.value(0x6041)
    found = [
        *_state(word),
        *_fault(objects, emergencies, word, reset_command),
        *_supply(objects, word),
        *_control(word, operational),
        *_inputs(objects, word),
        *_brake(objects),
        *_motor(objects, written),
        *_unreadable(objects),
    ]
    order = {Severity.FAILURE: 0, Severity.WARNING: 1, Severity.OK: 2}
    return sorted(found, key=lambda finding: order[finding.level])


def velocity_step(velocity_units_per_rps: float, feedback_band_rps: float) -> list[HostFinding]:
    """Resolution of the velocity against the band in which the friction observer takes it for zero."""
    step_rps = 1.0 / velocity_units_per_rps
    text = f"one count of 0x606C is {step_rps:.3g} rps"
    if step_rps <= COARSE_SHARE * feedback_band_rps:
        return [ok("velocity", text)]
    return [
        warning(
            "velocity", f"{text}: coarse compared with the observer's band of {feedback_band_rps:g} rps",
            "choose a finer unit in the drive (0x60A9, for example 0xFDB44700: thousandths of rpm)",
        )
    ]  # fmt: skip


def _state(word: int | None) -> Iterator[HostFinding]:
    if word is None:
        yield failure("state", "the drive reports no statusword (0x6041)", "is it a CiA 402 drive, and the right node?")
        return
    state, text = state_of(word), f"statusword 0x{word:04X}: {state_name(word)}"
    if state in FAULT_STATES:
        pass  # reported with the fault
    elif state == STATE_OPERATION_ENABLED:
        yield failure(
            "state",
            f"{text}: another master has enabled it",
            "disable it with its other master; close the vendor's tool",
        )
    elif state == STATE_QUICK_STOP_ACTIVE:
        yield warning("state", text, "the bring-up disables the drive, which ends it")
    elif state == STATE_NOT_READY:
        yield failure(
            "state", text, "the drive is starting, testing itself or without supply: wait, then check the supply"
        )
    elif state == STATE_UNKNOWN:
        yield failure("state", f"{text} (no state of CiA 402)", "is this the drive's statusword (0x6041)?")
    else:
        yield ok("state", text)
    if word & STATUS_WARNING:
        yield warning("warning", "the drive warns (bit 7 of the statusword)", "see its codes")


def _fault(
    objects: SdoObjects, emergencies: Sequence[Emergency], word: int | None, reset_command: str
) -> Iterator[HostFinding]:
    said = []
    if code := objects.value(0x603F):
        said.append(f"0x603F {code_text(code)}")
    if errors := [one for one in emergencies if one.code]:
        said.append(emergency_text(errors[-1]))
    if register := objects.value(0x1001):
        said.append(f"error register 0x1001 {register_text(register)}")
    kept = [objects.value(0x1003, sub) for sub in range(1, HISTORY + 1)]
    history = ", ".join(history_text(entry) for entry in kept[: objects.value(0x1003) or 0] if entry)
    past = [f"kept in 0x1003: {history}"] * bool(history)
    if word is not None and state_of(word) in FAULT_STATES:
        yield failure(
            "fault", "; ".join([f"statusword 0x{word:04X}: {state_name(word)}", *said, *past]),
            f"look up the code in the vendor's manual and remove the cause; then clear it: `{reset_command}`",
        )  # fmt: skip
    elif said:
        yield warning("fault", "; ".join([*said, *past]), "look up the code in the vendor's manual")
    elif history:
        yield ok("history", f"earlier errors in 0x1003: {history}")


def _supply(objects: SdoObjects, word: int | None) -> Iterator[HostFinding]:
    """DC link, and bit 4 of the statusword."""
    link_mv = objects.value(0x6079)
    link_v = None if link_mv is None else link_mv * 1e-3
    powered = bool(word and word & STATUS_VOLTAGE_ENABLED)
    if link_v is not None and link_v < LOWEST_DC_LINK_V:
        text = f"DC link (0x6079): {link_v:.1f} V: the power stage is not supplied"
        if powered:
            yield warning("supply", f"{text}, although bit 4 of the statusword is 1", "measure it")
        else:
            yield failure("supply", text, "switch the power supply on; check fuse, contactor and emergency stop")
        return
    if powered:
        yield ok("supply", "voltage at the power stage" + (f", DC link {link_v:.1f} V" if link_v is not None else ""))
        return
    if word is None or _interlock(objects):
        return  # a missing object is reported elsewhere
    if link_v is None:
        text = "bit 4 of the statusword is 0: no voltage at the power stage"
        yield warning("supply", text, "is the power supply on, is STO (safe torque off) wired and released?")
    else:
        text = f"bit 4 of the statusword is 0 although the DC link has {link_v:.1f} V"
        yield warning("supply", text, "is STO (safe torque off) wired and released? Some drives set it when enabled")


def _control(word: int | None, operational: bool) -> Iterator[HostFinding]:
    if word is None or word & STATUS_REMOTE:
        return
    text = "bit 9 of the statusword is 0: the drive ignores our controlword (local control)"
    remedy = "close the vendor's tool, and choose CANopen as the source of commands in the drive"
    if operational:
        yield failure("control", text, remedy)
    else:
        yield warning("control", f"{text}; some drives set it in NMT OPERATIONAL only", remedy)


def _interlock(objects: SdoObjects) -> bool:
    inputs = objects.value(0x60FD)
    return inputs is not None and bool(inputs & INPUT_INTERLOCK)


def _inputs(objects: SdoObjects, word: int | None) -> Iterator[HostFinding]:
    inputs = objects.value(0x60FD)
    if inputs is None:
        return
    if _interlock(objects):
        text = f"0x60FD is 0x{inputs:08X}: the interlock input (bit 3; STO in most drives) is active"
        if word is not None and not word & STATUS_VOLTAGE_ENABLED:
            yield failure("STO", text, "release STO: both channels need their voltage, and the safety relay its reset")
        else:
            yield warning("STO", f"{text}, although there is voltage at the power stage", "see the manual for this bit")
    switches = [
        name for bit, name in ((INPUT_NEGATIVE_LIMIT, "negative"), (INPUT_POSITIVE_LIMIT, "positive")) if inputs & bit
    ]
    if len(switches) == 2:
        yield failure(
            "limit switches", f"0x60FD is 0x{inputs:08X}: both limit switches are active",
            "they are not wired, or their polarity is wrong in the drive: it then moves in neither direction",
        )  # fmt: skip
    elif switches:
        yield warning(
            "limit switches", f"0x60FD is 0x{inputs:08X}: the {switches[0]} limit switch is active",
            "the axis is at its end: move it away by hand, with the brake released and the power off",
        )  # fmt: skip
    if not switches and not _interlock(objects):
        yield ok("inputs", f"0x60FD is 0x{inputs:08X}: no limit switch, no interlock")


def _brake(objects: SdoObjects) -> Iterator[HostFinding]:
    outputs = objects.value(0x60FE, 1)
    if outputs is None or not outputs & OUTPUT_BRAKE:
        return
    yield warning(
        "brake", "the brake is set (0x60FE:01, bit 0)",
        "the drive must release it when it is enabled: set its brake control and times with the vendor's tool",
    )  # fmt: skip


def _motor(objects: SdoObjects, written: Sequence[str]) -> Iterator[HostFinding]:
    for index, what in ((0x6076, "rated torque"), (0x6075, "rated current")):
        if objects.value(index) == 0:
            text = f"0x{index:04X} ({what}) is 0: the motor has not been configured in the drive"
            if f"0x{index:04X}:00" in written:
                yield warning("motor", f"{text}; the axis file writes it", "check the motor data in the drive")
            else:
                yield failure("motor", text, "enter the motor's data with the vendor's tool and tune its current loop")
    limit = objects.value(0x6072)
    if "0x6072:00" in written:
        return
    if limit == 0:
        yield failure("torque limit", "0x6072 is 0: the drive makes no torque", "set drive.max_torque_permille")
    elif limit is not None and limit < LOWEST_TORQUE_LIMIT:
        text = f"0x6072 limits the torque to {limit / TORQUE_LIMIT_PERMILLE:.0%} of the rated torque"
        yield warning("torque limit", text, "set drive.max_torque_permille if this is too low")


def _unreadable(objects: SdoObjects) -> Iterator[HostFinding]:
    if objects.unreadable:
        names = ", ".join(f"{name} ({reason})" for name, reason in sorted(objects.unreadable.items()))
        yield warning("not read", f"objects that could not be read: {names}", "see the vendor's manual")
