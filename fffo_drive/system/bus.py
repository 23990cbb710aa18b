"""The CAN interface of an axis: is it up, at which bit rate, with what queue, behind which driver."""

from __future__ import annotations

import json
from typing import Any

from .findings import HostFinding, Wanted, failure, ok, warning
from .host import Host

IP_LINK = ("ip", "-details", "-json", "link")
SHORTEST_QUEUE, LONGEST_QUEUE = 4, 32  # frames: what one period may send; what takes 4 ms on a bus at 1 Mbit/s
USB_FASTEST_HZ = 500  # above: refused
USB_REASON = (
    "USB hands frames over once in 1 ms (full speed) or in batches, 0.5 to 1 ms to and fro before the bus is counted"
)
SLOW_DRIVERS = {"mcp251x": "two receive buffers behind SPI: it loses frames above some thousand a second"}
DRIVER_ADVICE = (
    "use a PCIe, M.2 or SPI controller on SocketCAN (peak_pciefd, kvaser_pciefd, m_can, mcp251xfd), or {rate} Hz"
)


def interface_bitrate_hz(host: Host, bus: str) -> int | None:
    """The bit rate of a CAN interface; None on a loopback bus, and where the system does not tell it."""
    kind, _, name = bus.partition(":")
    printed = host.output(IP_LINK) if kind == "socketcan" else None
    try:
        links = {link["ifname"]: link for link in json.loads(printed or "[]")}
        found = links[name]["linkinfo"]["info_data"]["bittiming"]["bitrate"]
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    return found if isinstance(found, int) else None


def bus_findings(host: Host, wanted: Wanted) -> list[HostFinding]:
    """All about the bus: of the axis's interface, or of every CAN interface when no axis is given."""
    subject = "can"
    kind, _, name = (wanted.bus or "").partition(":")
    if kind == "loopback":
        return [ok(subject, f"{wanted.bus} is a bus on this machine's loopback network: no interface, no wire time")]
    printed = host.output(IP_LINK)
    if printed is None:
        return [warning(subject, "interfaces unknown: `ip -details -json link` does not work", "apt install iproute2")]
    try:
        links = {link["ifname"]: link for link in json.loads(printed) if link.get("link_type") == "can"}
    except (ValueError, TypeError, KeyError, AttributeError):
        return [
            warning(subject, "interfaces unknown: `ip -details -json link` printed no JSON", "apt install iproute2")
        ]
    if not name:
        if not links:
            return [warning(subject, "no CAN interface on this machine", "plug one in, or use loopback:PORT")]
        return [finding for link in links.values() for finding in interface_findings(host, wanted, link)]
    if name not in links:
        others = f"there is {', '.join(sorted(links))}" if links else "there is no CAN interface at all"
        remedy = (
            f"modprobe vcan; ip link add {name} type vcan; ip link set {name} up" if name.startswith("vcan")
            else "plug it in and load its driver (dmesg | grep -i can), or name another one under drive.bus"
        )  # fmt: skip
        return [failure(f"{subject} {name}", f"no such interface; {others}", remedy)]
    return interface_findings(host, wanted, links[name])


def interface_findings(host: Host, wanted: Wanted, link: dict[str, Any]) -> list[HostFinding]:
    """All about one interface."""
    name, kind = link["ifname"], link.get("linkinfo", {}).get("info_kind", "")
    data = link.get("linkinfo", {}).get("info_data", {})
    findings = [driver(host, wanted, name, kind)]
    if kind not in ("vcan", "vxcan"):
        findings += [bit_rate(wanted, name, link, data), restart(name, data), controller_mode(name, data)]
    elif "UP" not in link.get("flags", []):
        findings.append(failure(f"can {name}", "is down", f"ip link set {name} up"))
    findings.append(queue(name, link))
    return findings


def driver(host: Host, wanted: Wanted, name: str, kind: str) -> HostFinding:
    """Which driver; USB adapters and serial lines are too slow for fast loops."""
    subject = f"can {name} driver"
    if kind in ("vcan", "vxcan"):
        return ok(subject, f"{kind}: a virtual bus, without wire time")
    device = f"/sys/class/net/{name}/device"
    program, bus = host.link(f"{device}/driver"), host.link(f"{device}/subsystem")
    if name.startswith("slcan") or kind == "slcan":
        program, bus = "slcan", "a serial line"
    if bus in ("usb", "a serial line"):
        shown = f"{program or 'unknown driver'} on {'USB' if bus == 'usb' else bus}"
        advice = DRIVER_ADVICE.format(rate=USB_FASTEST_HZ)
        if wanted.rate_hz > USB_FASTEST_HZ:
            return failure(subject, f"{shown}: refused at {wanted.rate_hz} Hz: {USB_REASON}", advice)
        return warning(
            subject, f"{shown} at {wanted.rate_hz} Hz: {USB_REASON}; late answers are to be expected", advice
        )
    if program is None:
        return warning(subject, "unknown: /sys names none", "mount -t sysfs sysfs /sys")
    if program in SLOW_DRIVERS and wanted.rate_hz > USB_FASTEST_HZ:
        return warning(subject, f"{program}: {SLOW_DRIVERS[program]}", DRIVER_ADVICE.format(rate=USB_FASTEST_HZ))
    return ok(subject, f"{program} on {bus or 'an unknown bus'}")


def bit_rate(wanted: Wanted, name: str, link: dict[str, Any], data: dict[str, Any]) -> HostFinding:
    """Up, with the bit rate of the axis file."""
    subject = f"can {name}"
    command = f"ip link set {name} down; ip link set {name} up type can bitrate {wanted.bitrate_hz} restart-ms 100"
    found = data.get("bittiming", {}).get("bitrate")
    if "UP" not in link.get("flags", []):
        return failure(subject, "is down", command)
    if found is None:
        return failure(subject, "has no bit rate", command)
    if found != wanted.bitrate_hz:
        return failure(subject, f"bit rate {found}, the axis file says {wanted.bitrate_hz} (drive.bitrate_hz)", command)
    sample = data["bittiming"].get("sample_point", "?")
    return ok(subject, f"up, {found} bit/s, sample point {sample}")


def restart(name: str, data: dict[str, Any]) -> HostFinding:
    """What happens after a bus-off, and where the controller is now."""
    subject = f"can {name} bus-off"
    state = data.get("state", "unknown state")
    restart_ms = data.get("restart_ms", 0)
    if state == "BUS-OFF":
        return failure(
            subject, "the controller is off the bus: nobody acknowledges, or the bit rate is wrong",
            f"check wiring, termination and the drive's power; ip link set {name} type can restart",
        )  # fmt: skip
    if not restart_ms:
        return warning(
            subject, f"{state}; stays off the bus after a bus-off until somebody restarts it (restart-ms 0)",
            f"ip link set {name} down; ip link set {name} up type can restart-ms 100",
        )  # fmt: skip
    counters = data.get("berr_counter", {})
    if state in ("ERROR-WARNING", "ERROR-PASSIVE"):
        return warning(
            subject, f"{state}, error counters tx {counters.get('tx', '?')}, rx {counters.get('rx', '?')}",
            "check termination (60 ohm between CAN_H and CAN_L), wiring, and that the drive is powered",
        )  # fmt: skip
    return ok(subject, f"{state}, joins again {restart_ms} ms after a bus-off")


def controller_mode(name: str, data: dict[str, Any]) -> HostFinding:
    """Modes in which the controller cannot talk, or talks to itself."""
    subject = f"can {name} mode"
    modes = set(data.get("ctrlmode", []))
    command = f"ip link set {name} down; ip link set {name} up type can"
    if "LISTEN-ONLY" in modes:
        return failure(subject, "listens only: it sends nothing", f"{command} listen-only off")
    if "LOOPBACK" in modes:
        return failure(subject, "is looped back: the drive hears nothing", f"{command} loopback off")
    if "BERR-REPORTING" in modes:
        return warning(
            subject, "reports every single bus error: an interrupt each, thousands a second on a bad bus",
            f"{command} berr-reporting off",
        )  # fmt: skip
    return ok(subject, ", ".join(sorted(modes)).lower() or "ordinary")


def queue(name: str, link: dict[str, Any]) -> HostFinding:
    """The transmit queue: room for a period, not for old commands."""
    subject = f"can {name} queue"
    length = link.get("txqlen", 0)
    command = f"ip link set {name} txqueuelen 16"
    if length < SHORTEST_QUEUE and link.get("qdisc") != "noqueue":
        return warning(subject, f"{length} frames: less than a period sends", command)
    if length > LONGEST_QUEUE and link.get("qdisc") != "noqueue":
        return warning(subject, f"{length} frames: old commands would go out when the bus comes back", command)
    return ok(subject, f"{length} frames" if length else "none")
