"""Recorded machines: files of /proc and /sys as the kernel writes them, and what `ip` prints, for the doctor."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

Files = dict[str, str]
IP = "commands/ip -details -json link"

LIMITS = """\
Limit                     Soft Limit           Hard Limit           Units
Max cpu time              unlimited            unlimited            seconds
Max locked memory         {memory}            {memory}            bytes
Max realtime priority     {priority}                   {priority}
Max realtime timeout      unlimited            unlimited            us
"""
STATUS = """\
Name:	fffo-drive
CapEff:	{capabilities}
Cpus_allowed_list:	{cpus}
"""
INTERRUPTS = """\
            CPU0       CPU1       CPU2       CPU3
   8:          1          0          0          0  IR-IO-APIC    8-edge      rtc0
 122:     401233          0          0        {disk}  IR-PCI-MSI 524288-edge      nvme0q1
 131:          0          0          0    9182733  IR-PCI-MSI 1048576-edge      can0
 NMI:         12         10         11          9   Non-maskable interrupts
 LOC:     901234     801234     701234      12345   Local timer interrupts
"""
CAN0: dict[str, Any] = {
    "ifindex": 4,
    "ifname": "can0",
    "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
    "mtu": 16,
    "qdisc": "pfifo_fast",
    "operstate": "UP",
    "txqlen": 16,
    "link_type": "can",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "state": "ERROR-ACTIVE",
            "berr_counter": {"tx": 0, "rx": 0},
            "restart_ms": 100,
            "bittiming": {"bitrate": 1000000, "sample_point": "0.750"},
            "clock": 80000000,
        },
    },
}
VCAN0: dict[str, Any] = {
    "ifindex": 5, "ifname": "vcan0", "flags": ["NOARP", "UP", "LOWER_UP"], "mtu": 72, "qdisc": "noqueue",
    "operstate": "UNKNOWN", "txqlen": 1000, "link_type": "can", "linkinfo": {"info_kind": "vcan"},
}  # fmt: skip
ETHERNET = {"ifindex": 2, "ifname": "eth0", "flags": ["UP"], "txqlen": 1000, "link_type": "ether"}


def links(*interfaces: dict[str, Any]) -> str:
    """What `ip -details -json link` prints for them."""
    return json.dumps([ETHERNET, *interfaces])


def can0(**changes: Any) -> dict[str, Any]:
    """The interface can0 with other values: of the link, or of its controller."""
    link = copy.deepcopy(CAN0)
    for name, value in changes.items():
        (link if name in link else link["linkinfo"]["info_data"])[name] = value
    return link


def desktop() -> Files:
    """A PC as it should be: PREEMPT_RT, CPU 3 isolated, CAN on PCIe, root's shell in an unlimited service."""
    return {
        "proc/sys/kernel/osrelease": "6.12.43+deb13-rt-amd64\n",
        "proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian 6.12.43-1 (2025-08-27)\n",
        "proc/sys/kernel/sched_rt_runtime_us": "950000\n",
        "proc/sys/kernel/sched_rt_period_us": "1000000\n",
        "sys/kernel/realtime": "1\n",
        "boot/config-6.12.43+deb13-rt-amd64": "CONFIG_PREEMPT_RT=y\n# CONFIG_RT_GROUP_SCHED is not set\n",
        "proc/cmdline": "root=/dev/sda1 isolcpus=managed_irq,domain,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0-2\n",
        "proc/cpuinfo": "model name\t: Intel(R) Core(TM) i5\nflags\t\t: fpu tsc constant_tsc nonstop_tsc\n",
        "sys/class/dmi/id/sys_vendor": "Dell Inc.\n",
        "proc/self/limits": LIMITS.format(memory="unlimited", priority="98"),
        "proc/self/status": STATUS.format(capabilities="0000000000000000", cpus="0-2"),
        "proc/interrupts": INTERRUPTS.format(disk=0),
        "proc/irq/122/effective_affinity_list": "0\n",
        "proc/irq/131/effective_affinity_list": "3\n",
        "sys/devices/system/cpu/online": "0-3\n",
        "sys/devices/system/cpu/isolated": "3\n",
        "sys/devices/system/cpu/nohz_full": "3\n",
        "sys/devices/system/cpu/cpu3/topology/thread_siblings_list": "3\n",
        "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor": "performance\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state0/name": "POLL\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state0/latency": "0\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state0/disable": "0\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state1/name": "C1E\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state1/latency": "10\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state1/disable": "0\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state2/name": "C10\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state2/latency": "890\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state2/disable": "1\n",
        "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc\n",
        "sys/devices/system/clocksource/clocksource0/available_clocksource": "tsc hpet acpi_pm\n",
        "sys/class/net/can0/device/driver": "->../../../../bus/pci/drivers/peak_pciefd",
        "sys/class/net/can0/device/subsystem": "->../../../../bus/pci",
        IP: links(CAN0),
    }


def laptop() -> Files:
    """A laptop as it comes: desktop kernel, powersave, hyper-threads, a USB adapter that is down, a user's shell."""
    files = desktop()
    for name in ("sys/kernel/realtime", "boot/config-6.12.43+deb13-rt-amd64", "sys/devices/system/cpu/nohz_full"):
        del files[name]
    files |= {
        "proc/sys/kernel/osrelease": "6.12.43+deb13-amd64\n",
        "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian 6.12.43-1 (2025-08-27)\n",
        "boot/config-6.12.43+deb13-amd64": "CONFIG_PREEMPT_VOLUNTARY=y\nCONFIG_PREEMPT_DYNAMIC=y\n",
        "proc/cmdline": "root=/dev/sda1 quiet\n",
        "proc/self/limits": LIMITS.format(memory="8388608", priority="0"),
        "proc/self/status": STATUS.format(capabilities="0000000000000000", cpus="0-3"),
        "sys/devices/system/cpu/isolated": "\n",
        "sys/devices/system/cpu/cpu3/topology/thread_siblings_list": "1,3\n",
        "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor": "powersave\n",
        "sys/devices/system/cpu/cpu3/cpuidle/state2/disable": "0\n",
        "proc/interrupts": INTERRUPTS.format(disk=7712),
        "proc/irq/122/effective_affinity_list": "3\n",
        "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
        "sys/class/net/can0/device/driver": "->../../../../../../bus/usb/drivers/gs_usb",
        "sys/class/net/can0/device/subsystem": "->../../../../../../bus/usb",
        IP: links(can0(flags=["NOARP", "ECHO"], txqlen=1000, bittiming={}, restart_ms=0, state="STOPPED")),
    }
    return files


def guest() -> Files:
    """A virtual machine with two CPUs, RT_GROUP_SCHED, no CAN, and `ip` of its own; root's shell."""
    files = {
        "proc/sys/kernel/osrelease": "6.18.44-guest\n",
        "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC @0\n",
        "proc/sys/kernel/sched_rt_runtime_us": "950000\n",
        "proc/sys/kernel/sched_rt_period_us": "1000000\n",
        "sys/kernel/debug/sched/preempt": "(none) voluntary full lazy\n",
        "boot/config-6.18.44-guest": "CONFIG_PREEMPT_NONE=y\nCONFIG_RT_GROUP_SCHED=y\n",
        "proc/cmdline": "console=ttyS0 quiet\n",
        "proc/cpuinfo": "flags\t\t: fpu tsc hypervisor\n",
        "sys/class/dmi/id/sys_vendor": "QEMU\n",
        "proc/self/limits": LIMITS.format(memory="8388608", priority="0"),
        "proc/self/status": STATUS.format(capabilities="000001ffffffffff", cpus="0-1"),
        "proc/interrupts": "           CPU0       CPU1\n 25:          0          1   IO-APIC   6-edge      ACPI:Ged\n",
        "sys/devices/system/cpu/online": "0-1\n",
        "sys/devices/system/clocksource/clocksource0/current_clocksource": "kvm-clock\n",
        IP: links(),
    }
    return files


def write(files: Files, root: Path) -> Path:
    """The files under a root directory; a text that begins with `->` becomes a link to the rest of it."""
    for name, text in files.items():
        place = root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if text.startswith("->"):
            place.symlink_to(text.removeprefix("->"))
        else:
            place.write_text(text, encoding="utf-8")
    return root
