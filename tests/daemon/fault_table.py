"""The fault table: what can happen to a moving axis, who notices, what happens, and within which time.

`ROWS` is the contract: the bounds hold for tests/bad_days/axis.yaml at 2 kHz, on an axis that turns at 10 rps. Where a
row names a script it is lived through in `fault_world`, on the simulated drive's own clock, and the measured times
stand beside the bounds; a running daemon lives through the other rows in test_faults.py. `tools/fault_table` writes it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from interpreted import hex_results

from fffo_drive.control import envelope as env

TABLE = Path(__file__).resolve().parents[2] / "tools" / "tables" / "faults.md"
COAST, QUICK = "coasts", "quick stop"
GOES_ON = "goes on and reports"

PARTS = 4  # interpreters that share the scripts
LONGEST_PART_S = 400.0

QUICK_MS = 255.0  # from 10 rps on the drive's quick stop ramp (0x6085)
COAST_MS = 425.0  # by its friction alone
OSCILLATING_MS = 301.0  # following_error_s, and a tenth of a second
FROM_ANY_SPEED_MS = 350.0  # quick stop from up to three times as fast


class Row(NamedTuple):
    """One fault."""

    name: str
    what: str
    noticed_by: str
    reaction: str
    torque_ms: float | None = None  # bound until no torque of ours acts; None: the axis goes on
    standstill_ms: float | None = None  # bound until the shaft stands
    script: str | None = None  # of fault_world; None: a running daemon (test_faults.py)


def stops(name: str, what: str, by: str, how: str, torque_ms: float, script: str | None = None) -> Row:
    """A row in which the axis stops: what the reaction takes comes on top of what the noticing takes."""
    longest = QUICK_MS if how.startswith(QUICK) else COAST_MS
    return Row(name, what, by, how, torque_ms, torque_ms + longest, script or name)


def oscillates(name: str, what: str, by: str) -> Row:
    """A row whose times count from the first tick at the current limit, or with an error beyond its limit."""
    return Row(name, what, by, LATCHED, OSCILLATING_MS, OSCILLATING_MS + FROM_ANY_SPEED_MS, name)


FOREIGN = "the envelope: a frame that only we may send"
SILENT = "the drive: no command for command_timeout_ms (0x1400:5)"
BY_DRIVE = f"{QUICK} by the drive (0x6007)"
LATCHED = f"{QUICK}, fault latched"
RELEASED = f"{COAST}, fault latched"

ROWS: tuple[Row, ...] = (
    stops("killed", "the daemon is killed (kill -9, out of memory, the watchdog's SIGABRT)", SILENT,
          f"{BY_DRIVE}; the service manager starts the daemon again, which enables nothing", 21, "host_silent"),
    stops("stopped", "the daemon is stopped (SIGSTOP, a debugger, swapping)", SILENT,
          f"{BY_DRIVE}; goes on without torque, fault latched", 21, "host_silent"),
    stops("loop_stalled", "the loop's thread hangs", f"{SILENT}; the supervisor and the watchdog",
          f"{BY_DRIVE}; fault latched, the watchdog is not fed", 21, "host_silent"),
    Row("host_pauses", "the daemon is held up for 5 ms", "the loop: deadlines missed", GOES_ON, script="host_pauses"),
    stops("answers_missing", "velocity feedback (TPDO1) is missing", "the envelope: feedback_missing_ticks", LATCHED,
          6),
    stops("statusword_missing", "the statusword (TPDO2) is missing", "the envelope: status_missing_ticks", LATCHED, 51),
    stops("sync_missing", "SYNC does not reach the drive",
          "the envelope: no answers; later the drive: SYNC missing (0x2010)",
          f"{QUICK} by SDO (no RPDO acts without SYNC), fault latched", 7),
    stops("commands_missing", "commands (RPDO) do not reach the drive", SILENT, f"{BY_DRIVE}; fault latched", 21),
    stops("our_heartbeat_lost", "our heartbeat does not reach the drive",
          "the drive: heartbeat_timeout_ms (0x1016)", f"{BY_DRIVE}; fault latched", 151),
    stops("drive_heartbeat_lost", "the drive's heartbeat is missing", "the envelope: heartbeat_timeout_s", LATCHED,
          501),
    stops("drive_fault", "the drive trips (overcurrent)", "the drive; the envelope by statusword and EMCY",
          f"{COAST} by the drive (0x605E), fault latched", 1),
    stops("emergency", "EMCY without a fault state", "the envelope", LATCHED, 2),
    Row("warning", "EMCY of a code in drive.warning_codes, or statusword bit 7 (warning)", "the supervisor", GOES_ON,
        script="warning"),
    stops("local_control", "the drive is switched to local control (statusword bit 9 is 0)",
          "the envelope: bit 9 for 125 ms; at rest the supervisor, which then enables nothing", LATCHED, 127),
    stops("not_following", "the drive does not follow 0x6071 (statusword bits 11 and 12 are 0)",
          "the envelope: bit 12 for 125 ms", LATCHED, 127),
    stops("drive_rebooted", "the drive restarts", "the envelope: boot-up message", RELEASED, 1),
    stops("keeps_torque_pre_operational",
          "the drive goes to NMT pre-operational, where it hears no RPDO, and keeps its torque",
          "the envelope: heartbeat, or feedback_missing_ticks", f"{QUICK} by SDO, fault latched", 7),
    stops("keeps_torque_stopped", "the drive goes to NMT stopped, where it hears NMT alone, and keeps its torque",
          "the envelope: heartbeat, or feedback_missing_ticks",
          f"{QUICK}: put into pre-operational, then by SDO; fault latched", 8),
    stops("keeps_torque_silent", "as before, and its heartbeat does not say so in time",
          "the envelope: feedback_missing_ticks", f"{QUICK}: put into pre-operational, then by SDO; fault latched", 8),
    stops("drive_not_operational", "somebody puts the drive into NMT stopped or pre-operational",
          "the drive; the envelope: heartbeat, or feedback_missing_ticks", f"{BY_DRIVE}; fault latched", 1),
    stops("supply_lost", "the DC link loses its supply", "the drive: undervoltage; the envelope by EMCY", RELEASED, 12),
    stops("resolver_lost", "the resolver is lost", "the drive; the envelope by EMCY", RELEASED, 1),
    stops("drive_bus_off", "the drive's CAN controller is off the bus", "the drive; the envelope", LATCHED, 1),
    stops("bus_off", "our CAN controller is off the bus", f"the envelope: error frame; {SILENT}",
          f"{BY_DRIVE}; nothing is sent, fault latched", 21),
    stops("interface_gone", "the interface is down or gone", f"the envelope: errno of send; {SILENT}",
          f"{BY_DRIVE}; fault latched", 21),
    stops("foreign_sync", "another master sends SYNC", FOREIGN, LATCHED, 2),
    stops("foreign_command", "somebody else commands torque by our RPDO, behind each of ours", FOREIGN,
          f"{QUICK}, by SDO beside the RPDO; fault latched", 2),
    stops("foreign_master", "somebody else enables the drive again and again by our RPDO", FOREIGN,
          f"{QUICK}; enabled again, the drive is put into pre-operational, where it hears no RPDO; fault latched", 20),
    stops("foreign_feedback", "somebody else sends the drive's feedback (TPDO1) as well, at our rate",
          "the loop: more second answers to SYNC than one in 100", LATCHED, 8),
    stops("foreign_heartbeat", "somebody else sends our heartbeat", FOREIGN, LATCHED, 2),
    stops("foreign_nmt", "somebody else stops the drive by NMT, and it keeps its torque", FOREIGN,
          f"{QUICK}: put into pre-operational, then by SDO; fault latched", 4),
    stops("foreign_sdo", "somebody else writes 0x6060 by SDO", FOREIGN, LATCHED, 2),
    Row("settings_changed", "0x1016, the mode or a mapping of the drive is changed behind our back",
        "the service: everything that bring-up wrote is read again, an object every 0.1 s",
        f"{QUICK}, fault latched; the next start writes it again"),
    stops("following_error", "velocity error beyond following_error_rps for following_error_s", "the envelope", LATCHED,
          1),
    stops("overspeed", "velocity beyond speed_limit_rps", "the envelope", LATCHED, 1),
    stops("position_window", "position outside position_window_rev", "the envelope", LATCHED, 1),
    stops("i2t", "continuous current exceeded for too long", "the envelope", LATCHED, 1),
    oscillates("lost_load", "three quarters of the inertia are lost: the loop has four times its gain",
               "the envelope: following_error, which an alternating error does not reset"),
    oscillates("lost_load_wide_limit", "the same where following_error_rps is three times as large",
               "the envelope: oscillation, a command that reverses at its limit"),
    oscillates("loose_coupling", "the coupling to three quarters of the inertia gets a gap of 0.2 rev",
               "the envelope: following_error"),
    oscillates("wrong_inertia", "gains for four times the inertia are set", "the envelope: oscillation"),
    oscillates("wrong_sign", "the drive turns the sign of the torque", "the envelope: overspeed"),
    oscillates("resonance", "the stiffness of a joint falls: its resonance, of half the inertia, from 400 to 110 Hz",
               "the envelope: overspeed"),
    Row("clock_stepped", "the wall clock is stepped", "nobody: the loop reads CLOCK_MONOTONIC alone", "goes on",
        script="clock_stepped"),
    Row("sdo_timeout", "the drive does not answer SDO in bring-up", "the supervisor",
        "offline, reported once, tried again; SYNC and torque never begin"),
    Row("another_master", "another master, or a second service, is on the bus at the start",
        "the supervisor: it listens before it sends", "offline, reported once, nothing is sent, tried again"),
    stops("supervisor_silent", "the supervisor's thread hangs",
          "the loop: daemon.supervisor_timeout_s (here 150 ms); the watchdog",
          f"{QUICK}, then the loop ends, and with it our heartbeat; fault latched", 152),
    Row("holder_gone", "the client that holds the axis goes away", "the supervisor",
        "client_loss: brakes to standstill and disables; or quick stop; or goes on"),
    Row("recorder_dead", "the recorder's thread dies", "the supervisor", GOES_ON),
    Row("disk_full", "the disk is full", "the recorder", GOES_ON),
    Row("record_required", "the recording fails, record_required is true", "the supervisor",
        "brakes to standstill and disables"),
    Row("recording_hangs", "the disk of the recording does not answer", "the supervisor: after 5 s",
        "goes on and reports; where record_required is true it brakes to standstill and disables"),
    Row("file_hangs", "the disk of the axis file, the model or the commissioning record does not answer",
        "the supervisor: after 5 s", "goes on; the reload is answered, all other requests are served"),
    Row("sockets_gone", "the sockets or their directory are deleted", "the server: within about a second",
        "goes on; they are made anew, and connections stay"),
    Row("api_flooded", "twenty clients send requests without a pause, some of them malformed", "the server",
        "goes on; each is read at 50 requests a second"),
    Row("config_rubbish", "the axis file is replaced with an invalid one and reloaded", "the supervisor", GOES_ON),
)  # fmt: skip

HEAD = """\
# Faults

Made by `tools/fault_table` from the rows of `tests/daemon/fault_table.py`; a test reproduces each. The axis turns at
10 rps at 2 kHz; limits and timeouts are those of `tests/bad_days/axis.yaml`. Times are on the simulated drive's own
clock, from the start of the fault: the bound, and in brackets the measured value. *Torque ends* when no torque that
this program commanded acts any more; during a quick stop the drive brakes with its own torque. For a loop that
oscillates or runs away they count from the first tick at the current limit, or with an error beyond
`following_error_rps`, which comes before the trip by `following_error_s` (200 ms) at most. Faults latch: only
`reset_fault` clears them, and torque needs another `enable`.

| fault | who notices | what happens | torque ends, ms | standstill, ms |
| --- | --- | --- | --- | --- |
"""


def line(row: Row, outcome: dict[str, Any] | None) -> str:
    """One line of the table."""

    def time(bound: float | None, key: str) -> str:
        return "-" if bound is None or outcome is None else f"{bound:.0f} ({outcome[key]:.0f})"

    times = time(row.torque_ms, "torque_ms"), time(row.standstill_ms, "standstill_ms")
    return f"| {row.what} | {row.noticed_by} | {row.reaction} | {times[0]} | {times[1]} |"


def measured() -> dict[str, dict[str, Any]]:
    """Live through every script, in two interpreters without compilation."""

    def part(number: int) -> list[Any]:
        return hex_results("daemon.fault_world", f"part_{number}", LONGEST_PART_S)

    with ThreadPoolExecutor(2) as pool:
        parts = pool.map(part, range(PARTS))
        found: list[Any] = [outcome for part in parts for outcome in part]
    return {outcome["row"]: outcome for outcome in found}


REACTIONS_HEAD = """
# Reactions

What the loop requests from the drive after a trip, unless `envelope.reactions` in the axis file says otherwise.
Whatever it requests, no torque is commanded from the tick of the trip on. Each trip is reported with what the drive
itself says (EMCY, 0x603F, 0x1003, statusword).

| trip | text | reaction | why |
| --- | --- | --- | --- |
"""
WORDS = {env.REACTION_COAST: "coast (disable voltage)", env.REACTION_QUICK_STOP: "quick stop"}


def reactions() -> str:
    """The trips, with what they lead to."""
    lines = [
        f"| `{env.TRIP_NAMES[trip]}` | {env.TRIP_TEXTS[trip]} | {WORDS[reaction]} | {why} |"
        for trip, (reaction, why) in env.DEFAULT_REACTIONS.items()
    ]
    return REACTIONS_HEAD + "\n".join(lines) + "\n"


def markdown(outcomes: dict[str, dict[str, Any]]) -> str:
    """Both tables."""
    return HEAD + "\n".join(line(row, outcomes.get(row.script or "")) for row in ROWS) + "\n" + reactions()


if __name__ == "__main__":
    TABLE.write_text(markdown(measured()), encoding="utf-8")
