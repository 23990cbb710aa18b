"""From any state of the drive to NMT operational: reset, identify, map, set its reactions, verify, start.

Everything that is written is read back. If the drive refuses or lacks an object, or keeps a different value,
DriveRefusedError names the object, the value and the drive's reason; silence raises BusUnavailableError. The drive is
not enabled here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from ...can import frame as can
from ..port import DriveIdentity, DriveRefusedError
from . import silence
from .checked import write_checked, write_if_present
from .config import CanopenDriveConfig
from .needs import mode_text, needs
from .object_map import MODE, MODE_DISPLAY, PdoMap, interpolation_period, object_name
from .sdo_objects import SdoObjects
from .sdo_writes import write_phase
from .service import (
    NMT_PRE_OPERATIONAL,
    NMT_RESET_COMMUNICATION,
    NMT_START,
    READ_ONLY,
    STATE_OPERATIONAL,
    Kept,
    SdoRefusedError,
    Service,
)

COB_ID_INVALID = 1 << 31
COB_ID_NO_RTR = 1 << 30  # some drives refuse a COB-ID with this bit cleared: keep it as found
COB_ID_MASK = COB_ID_INVALID | can.STANDARD_MASK
SYNC_PRODUCER = 1 << 30
RATING_TOLERANCE = 0.01
PDO_SLOTS = 4  # PDOs that every drive has; CiA 301 allows 512
MOST_PDO_SLOTS = 512
TORQUE_SLOPE = 0x6087  # per mille of the rated torque per second
SYNC_DISTANCE_S = 0.002  # before the loop runs, for a mode display that is updated with SYNC


def bring_up(
    service: Service, config: CanopenDriveConfig, check: Callable[[DriveIdentity], None] = lambda identity: None
) -> DriveIdentity:
    """Reset the node's communication, configure and verify everything; leaves it pre-operational.

    `check` refuses another drive before anything is written to it. Raises DriveRefusedError or BusUnavailableError.
    """
    for _ in range(2):  # a drive that is being switched on sends two boot-up messages
        service.kept.clear()
        _reset(service, config)
        identity = read_identity(service)
        check(identity)
        _check_drive(service, config)
        write_phase(service, config.sdo, "before_mapping")
        _check_ratings(service, config)
        _configure_sync(service, config)
        _configure_pdos(service, config)
        _configure_reactions(service, config)
        _set_mode(service, config)
        write_phase(service, config.sdo, "before_enable")
        if service.boot_ups == 1:
            return identity
    raise DriveRefusedError(
        f"{config.bus}: {service.boot_ups} boot-up messages of node {config.node_id} after one reset: "
        "two nodes have this id, or the drive restarts while it is set up; check node ids and supply"
    )


def start(service: Service, config: CanopenDriveConfig, send_sync: Callable[[], None]) -> None:
    """NMT start, confirmed by the drive's heartbeat; `send_sync` uses the loop's own link, which does not receive
    itself.

    Raises DriveRefusedError, BusUnavailableError.
    """
    service.check_one_node()
    service.command_nmt(NMT_START)
    if config.silence_detection == silence.LIFE_GUARDING:  # a guarded node reports its state on request
        service.send_message(can.HEARTBEAT + config.node_id, bytes(1), remote=True)
    if not service.wait_until(lambda: service.nmt_state == STATE_OPERATIONAL, config.start_timeout_s):
        raise DriveRefusedError(
            f"{config.bus}: node {config.node_id} does not report NMT state operational (heartbeat says "
            f"{service.nmt_state:#x}) within {config.start_timeout_s} s; see its error history 0x1003"
        )
    silence.begin(service, config)
    if config.mode_display == "with_sync":
        _await_mode(service, config, lambda: _one_sync(service, send_sync))


def read_identity(service: Service) -> DriveIdentity:
    """0x1018, 0x1008 and 0x100A; 0 or empty if the drive does not have the object."""
    numbers = [service.read_optional_int(0x1018, sub) or 0 for sub in range(1, 5)]
    vendor_id, product_code, revision, serial_number = numbers
    return DriveIdentity(
        vendor_id,
        product_code,
        revision,
        serial_number,
        read_text(service, 0x1008),
        read_text(service, 0x100A),
    )


def read_text(service: Service, index: int) -> str:
    """A string of the drive; empty if it does not have the object, or refuses it."""
    try:
        return service.read(index, 0).rstrip(b"\0").decode("latin-1")
    except SdoRefusedError:
        return ""


def _reset(service: Service, config: CanopenDriveConfig) -> None:
    """Back to the drive's own communication settings; the boot-up message shows that it is there."""
    service.forget()
    service.command_nmt(NMT_RESET_COMMUNICATION)
    if not service.wait_until(lambda: service.boot_ups > 0, config.start_timeout_s):
        service.read(0x1000, 0)  # a node that answers SDO all the same gets its own message
        raise DriveRefusedError(
            f"{config.bus}: node {config.node_id} answers SDO but sends no boot-up message after an NMT "
            f"reset (waited {config.start_timeout_s} s, CiA 301 7.2.8.3.3)"
        )
    service.command_nmt(NMT_PRE_OPERATIONAL)  # a node may start itself (0x1F80, bit 2): mappings change before that


def _check_drive(service: Service, config: CanopenDriveConfig) -> None:
    """Check the drive itself against the list of requirements that `drive-info` applies to a file."""
    found = needs(SdoObjects(service.read, most_timeouts=1), config)
    if found:
        raise DriveRefusedError(f"node {service.node_id}: {'; '.join(str(need) for need in found)}")


def _check_ratings(service: Service, config: CanopenDriveConfig) -> None:
    """0x6071 and 0x6077 count per mille of the rated torque: a wrong one would scale every command."""
    declared = [
        (0x6076, "rated_torque_nm", config.rated_torque_nm, "Nm", config.rated_torque_unit_nm),
        (0x6075, "rated_current_a", config.rated_current_a, "A", config.rated_current_unit_a),
    ]
    for index, key, value, unit, one in declared:
        if value is None:
            continue
        raw = service.read_optional_int(index, 0)
        if raw is None:
            continue
        if raw == 0:
            raise DriveRefusedError(
                f"node {service.node_id}: 0x{index:04X}:00 is 0: the drive does not know the rating of its motor; set "
                f"it to {round(value / one)} with the vendor's tool or by drive.sdo"
            )
        reported = raw * one
        if abs(reported - 1e3 * value) <= RATING_TOLERANCE * 1e3 * value and index == 0x6076:
            raise DriveRefusedError(
                f"node {service.node_id}: 0x6076:00 says {reported:.6g} Nm, 1000 times rated_torque_nm: {value}; "
                "a drive that counts uNm needs rated_torque_unit: uNm"
            )
        if index == 0x6075 and abs(reported * math.sqrt(2.0) - value) <= RATING_TOLERANCE * value:
            raise DriveRefusedError(
                f"node {service.node_id}: 0x6075:00 says {reported:.6g} A, rated_current_a: {value} is that times the "
                "root of two: a drive that counts rms needs rated_current_unit: mA_rms"
            )
        if abs(reported - value) > RATING_TOLERANCE * value:
            raise DriveRefusedError(
                f"node {service.node_id}: 0x{index:04X}:00 says {reported:.6g} {unit}, the configuration {key}: "
                f"{value}; make them agree, the torque command is scaled with it"
            )


def _configure_sync(service: Service, config: CanopenDriveConfig) -> None:
    reported = service.read_optional_int(0x1005, 0)  # a drive without the object uses the predefined COB-ID
    if reported is not None and reported & (SYNC_PRODUCER | can.STANDARD_MASK) != can.SYNC:
        if reported & SYNC_PRODUCER:  # the COB-ID of a producer must not be changed (CiA 301 7.5.2.5)
            silent = reported & ~SYNC_PRODUCER
            write_checked(service, 0x1005, 0, silent, 4, "a bus with one source of SYNC", mask=SYNC_PRODUCER)
        write_checked(service, 0x1005, 0, can.SYNC, 4, "receiving our SYNC", mask=SYNC_PRODUCER | can.STANDARD_MASK)
    if service.read_optional_int(0x1019, 0):  # a counter would need a byte in SYNC
        write_if_present(service, 0x1006, 0, 0, 4, "changing 0x1019")
        write_checked(service, 0x1019, 0, 0, 1, "SYNC without a counter")
    period_us = config.period_ns // 1000
    write_if_present(service, 0x1006, 0, period_us, 4, f"a SYNC period of {period_us} us")
    value, exponent = interpolation_period(config.period_ns)
    purpose = f"a control period of {period_us} us; a slower rate may be possible"
    if service.read_optional_int(0x60C2, 1) is not None:
        write_checked(service, 0x60C2, 1, value, 1, purpose)
        write_checked(service, 0x60C2, 2, exponent, 1, purpose)
        write_checked(service, 0x60C2, 1, value, 1, purpose)  # the new exponent may have changed the value


def _configure_pdos(service: Service, config: CanopenDriveConfig) -> None:
    _switch_off_others(service, 0x1400, {config.command.number}, "a drive that takes commands from one RPDO")
    _configure_pdo(service, 0x1400, config.command)
    for pdo in config.answers:
        _configure_pdo(service, 0x1800, pdo)
    _switch_off_others(service, 0x1800, {pdo.number for pdo in config.answers}, "a bus without other TPDOs")


def _switch_off_others(service: Service, first_index: int, used: set[int], purpose: str) -> None:
    """Switch off unused PDOs: they take time on the bus, or may use the COB-ID of the command."""
    for number in range(1, MOST_PDO_SLOTS + 1):
        index = first_index + number - 1
        cob_id = service.read_optional_int(index, 1)
        if cob_id is None and number > PDO_SLOTS:
            break
        if number not in used and cob_id is not None and not cob_id & COB_ID_INVALID:
            write_checked(
                service,
                index,
                1,
                cob_id | COB_ID_INVALID,
                4,
                purpose,
                mask=COB_ID_INVALID,
            )


def _configure_pdo(service: Service, first_index: int, pdo: PdoMap) -> None:
    """CiA 301 7.5.2.36: disable, empty the mapping, write it, set its length, enable with the new COB-ID.

    The COB-ID of a PDO in use must not change (CiA 301 7.5.2.35): it is disabled with the one that it has.
    """
    communication = first_index + pdo.number - 1
    mapping = communication + 0x200
    receives = first_index == 0x1400
    purpose = f"{'RPDO' if receives else 'TPDO'}{pdo.number}"
    found = service.read_int(communication, 1)
    cob_id = pdo.cob_id | found & COB_ID_NO_RTR
    if not found & COB_ID_INVALID:
        write_checked(service, communication, 1, found | COB_ID_INVALID, 4, f"disabling {purpose}", mask=COB_ID_INVALID)
    write_checked(service, communication, 2, pdo.transmission, 1, f"the transmission type of {purpose}")
    if not receives:
        # a leftover inhibit time or timer would delay or add frames
        inhibit = pdo.inhibit_ns // 100_000
        write_if_present(service, communication, 3, inhibit, 2, f"the inhibit time of {purpose}")
        write_if_present(service, communication, 5, 0, 2, f"{purpose} without an event timer")
    fixed_count = _count_is_fixed(service, mapping, len(pdo.objects), purpose)
    for sub, item in enumerate(pdo.objects, 1):
        write_checked(service, mapping, sub, item.word, 4, f"{item} in {purpose}")
    if not fixed_count:
        write_checked(service, mapping, 0, len(pdo.objects), 1, f"the mapping of {purpose}")
    write_checked(service, communication, 1, cob_id, 4, f"enabling {purpose}", mask=COB_ID_MASK)


def _count_is_fixed(service: Service, mapping: int, wanted: int, purpose: str) -> bool:
    """Empty a mapping so that it can be changed. True where the drive's number of entries is fixed and fits."""
    try:
        write_checked(service, mapping, 0, 0, 1, f"changing the mapping of {purpose}")
    except DriveRefusedError as error:
        refusal = error.__cause__
        read_only = isinstance(refusal, SdoRefusedError) and refusal.code == READ_ONLY
        if not read_only or service.read_int(mapping, 0) != wanted:
            raise
        return True
    return False


def _configure_reactions(service: Service, config: CanopenDriveConfig) -> None:
    """Reactions to silence of the master or the drive; if one is refused, the drive is not enabled."""
    emergency = can.EMERGENCY + config.node_id
    reported = service.read_optional_int(0x1014, 0)  # a drive without the object uses the predefined COB-ID
    if reported is not None and reported & COB_ID_MASK != emergency:
        if not reported & COB_ID_INVALID:  # a COB-ID in use must not be changed (CiA 301 7.5.2.17)
            write_checked(
                service, 0x1014, 0, reported | COB_ID_INVALID, 4, "changing EMCY messages", mask=COB_ID_INVALID
            )
        write_checked(service, 0x1014, 0, emergency, 4, "EMCY messages", mask=COB_ID_MASK)
    silence.configure(service, config)
    if config.quick_stop_option is not None:
        write_if_present(service, 0x605A, 0, config.quick_stop_option, 2, "a defined quick stop")
    if config.fault_reaction_option is not None:
        write_if_present(service, 0x605E, 0, config.fault_reaction_option, 2, "a defined fault reaction")
    if config.max_torque_permille is not None:
        write_checked(service, 0x6072, 0, config.max_torque_permille, 2, "the torque limit in the drive")


def _set_mode(service: Service, config: CanopenDriveConfig) -> None:
    """Set the mode with a target of zero; the display may follow a little later."""
    target, name = config.target, mode_text(config.mode)
    size = target.bits // 8
    try:
        service.write(MODE, 0, config.mode.to_bytes(1, "little", signed=True))
        service.write(target.index, target.sub, bytes(size))
    except SdoRefusedError as refusal:
        raise DriveRefusedError(f"node {service.node_id} refuses mode {name}: {refusal}") from refusal
    if config.mode_display == "at_once":
        _await_mode(service, config, lambda: None)
    elif config.mode_display == "not_checked":
        service.kept[MODE, 0] = Kept(config.mode, 1, 0xFF, f"mode {name}")
    if config.torque_slope is not None:
        purpose = "a target torque that acts at once (drive.torque_slope)"
        write_checked(service, TORQUE_SLOPE, 0, config.torque_slope, 4, purpose)
    if service.read_optional_int(target.index, target.sub):
        shown = object_name(target.index, target.sub)
        raise DriveRefusedError(f"node {service.node_id}: {shown} (target torque) cannot be set to zero")


def _await_mode(service: Service, config: CanopenDriveConfig, meanwhile: Callable[[], None]) -> None:
    """Wait until 0x6061 shows the mode. Raises DriveRefusedError."""
    deadline_s = time.monotonic() + config.start_timeout_s
    while (shown := _shown_mode(service)) != config.mode:
        if time.monotonic() > deadline_s:
            raise DriveRefusedError(
                f"node {service.node_id}: mode {mode_text(config.mode)} was set, but 0x6061:00 says {shown}; "
                "a drive that shows it later takes drive.mode_display: with_sync or not_checked"
            )
        meanwhile()
    service.kept[MODE_DISPLAY, 0] = Kept(config.mode, 1, 0xFF, f"mode {mode_text(config.mode)}")


def _shown_mode(service: Service) -> int:
    """0x6061 has 8 bits; an answer that does not tell its size has four bytes, the others without meaning."""
    return int.from_bytes(service.read(MODE_DISPLAY, 0)[:1], "little", signed=True)


def _one_sync(service: Service, send_sync: Callable[[], None]) -> None:
    """One SYNC before the loop sends its own; the drive is not enabled."""
    send_sync()
    service.wait_until(lambda: False, SYNC_DISTANCE_S)
