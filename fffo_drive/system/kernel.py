"""The kernel: how it preempts, what it allows a real-time thread, its clock, and whether it is a guest."""

from __future__ import annotations

import gzip
import re

from .findings import HostFinding, Wanted, failure, ok, warning
from .host import Host

CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
GOOD_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page")
SMALLEST_SHARE = 0.5  # of a CPU for real-time threads: the loop needs a quarter at most
RT_LIMITS = "/etc/security/limits.d/90-fffo-drive.conf"


def kernel_findings(host: Host, wanted: Wanted) -> list[HostFinding]:
    """All about the kernel, in the order in which it is to be read."""
    return [
        preemption(host),
        machine(host),
        throttling(host),
        group_scheduling(host),
        priority_limit(host, wanted),
        memory_limit(host, wanted),
        clock(host),
    ]


def kernel_options(host: Host) -> dict[str, str]:
    """CONFIG_* of the kernel, from /proc/config.gz or /boot; empty when it is not published."""
    packed = host.content("/proc/config.gz")
    text: str | None = None
    if packed is not None:
        try:
            text = gzip.decompress(packed).decode("utf-8", "replace")
        except (OSError, EOFError):
            text = None
    if text is None:
        text = host.text(f"/boot/config-{host.text('/proc/sys/kernel/osrelease')}")
    return dict(re.findall(r"^(CONFIG_\w+)=(.*)$", text or "", re.MULTILINE))


def preemption(host: Host) -> HostFinding:
    """PREEMPT_RT, or which lesser model."""
    subject = "kernel"
    release = host.text("/proc/sys/kernel/osrelease")
    version = host.text("/proc/sys/kernel/version") or ""
    remedy = "apt install linux-image-rt-amd64 (Debian), then reboot; any kernel built with CONFIG_PREEMPT_RT will do"
    if release is None:
        return warning(
            subject, "release unknown: /proc/sys/kernel/osrelease cannot be read", "mount -t proc proc /proc"
        )
    if host.text("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return ok(subject, f"{release}, PREEMPT_RT")
    model = _dynamic_model(host, version)
    if model in ("full", "lazy"):
        return warning(subject, f"{release}, preemption {model}: wakes late by 0.1 ms and more at times", remedy)
    return warning(subject, f"{release}, preemption {model}: kernel work may hold the loop up for milliseconds", remedy)


def _dynamic_model(host: Host, version: str) -> str:
    chosen = re.search(r"\((\w+)\)", host.text("/sys/kernel/debug/sched/preempt") or "")
    if chosen:
        return chosen.group(1)
    chosen = re.search(r"\bpreempt=(\w+)", host.text("/proc/cmdline") or "")
    if chosen:
        return chosen.group(1)
    options = kernel_options(host)
    for option, model in (("", "full"), ("_LAZY", "lazy"), ("_VOLUNTARY", "voluntary"), ("_NONE", "none")):
        if options.get(f"CONFIG_PREEMPT{option}") == "y":
            return model
    return "full" if "PREEMPT" in version.replace("PREEMPT_DYNAMIC", "") else "unknown"


def machine(host: Host) -> HostFinding:
    """Hardware, or a guest of a hypervisor."""
    subject = "machine"
    processors = host.text("/proc/cpuinfo")
    if processors is None:
        return warning(subject, "unknown: /proc/cpuinfo cannot be read", "mount -t proc proc /proc")
    vendor = host.text("/sys/class/dmi/id/sys_vendor") or "no name"
    if re.search(r"^flags\s*:.*\bhypervisor\b", processors, re.MULTILINE):
        return warning(
            subject, f"a virtual machine ({vendor}): other guests may take its processor for milliseconds",
            "use it for simulated drives; for hardware take a PC of its own",
        )  # fmt: skip
    return ok(subject, f"no hypervisor seen ({vendor})")


def throttling(host: Host) -> HostFinding:
    """How much of a CPU real-time threads may use."""
    subject = "rt throttling"
    runtime_us = host.number("/proc/sys/kernel/sched_rt_runtime_us")
    period_us = host.number("/proc/sys/kernel/sched_rt_period_us")
    if runtime_us is None or not period_us:
        return warning(subject, "unknown: kernel.sched_rt_runtime_us cannot be read", "mount -t proc proc /proc")
    if runtime_us < 0:
        return ok(
            subject, "off (kernel.sched_rt_runtime_us = -1): a real-time thread that hangs takes its CPU for ever"
        )
    share = runtime_us / period_us
    if share < SMALLEST_SHARE:
        level = failure if runtime_us == 0 else warning
        return level(
            subject, f"real-time threads get {100 * share:g} % of a CPU, then wait for the rest of a second",
            "sysctl -w kernel.sched_rt_runtime_us=950000 (and in /etc/sysctl.d/ to keep it)",
        )  # fmt: skip
    return ok(subject, f"real-time threads get up to {100 * share:g} % of a CPU")


def group_scheduling(host: Host) -> HostFinding:
    """CONFIG_RT_GROUP_SCHED refuses SCHED_FIFO in every control group without a budget, whatever the rights."""
    subject = "rt groups"
    options = kernel_options(host)
    if not options:
        return warning(
            subject, "kernel configuration not published: CONFIG_RT_GROUP_SCHED unknown",
            "if the service is refused SCHED_FIFO although limits are right: zgrep RT_GROUP_SCHED /boot/config-*",
        )  # fmt: skip
    if options.get("CONFIG_RT_GROUP_SCHED") != "y":
        return ok(subject, "CONFIG_RT_GROUP_SCHED is off")
    switched = re.search(r"\brt_group_sched=(\S+)", host.text("/proc/cmdline") or "")
    if switched:
        on = switched.group(1) not in ("0", "off", "n", "no", "false")
    else:
        on = options.get("CONFIG_RT_GROUP_SCHED_DEFAULT_DISABLED") != "y"
    if not on:
        return ok(subject, "CONFIG_RT_GROUP_SCHED is built in and switched off")
    if host.number("/proc/sys/kernel/sched_rt_runtime_us") == -1:
        return ok(subject, "CONFIG_RT_GROUP_SCHED is on, without effect while kernel.sched_rt_runtime_us is -1")
    return failure(
        subject, "CONFIG_RT_GROUP_SCHED is on: a service is refused SCHED_FIFO, as its control group has no budget",
        "boot with rt_group_sched=0 (new kernels), or sysctl -w kernel.sched_rt_runtime_us=-1, or take another kernel",
    )  # fmt: skip


def priority_limit(host: Host, wanted: Wanted) -> HostFinding:
    """RLIMIT_RTPRIO of this shell; the service has its own."""
    subject = "limit rtprio"
    if wanted.priority == 0:
        return ok(subject, "realtime.priority is 0: ordinary scheduling is asked for")
    if _capable(host, CAP_SYS_NICE):
        return ok(subject, f"this user may use any priority; the loop asks for {wanted.priority}")
    limit = _limit(host, "Max realtime priority")
    if limit is None:
        return warning(subject, "unknown: /proc/self/limits cannot be read", "mount -t proc proc /proc")
    if limit < wanted.priority:
        return failure(
            subject, f"{limit:g} in this shell, the loop asks for {wanted.priority} (the service has its own limit)",
            f"echo '@fffo-drive - rtprio {wanted.priority}' >> {RT_LIMITS}; usermod -aG fffo-drive $USER; log in again",
        )  # fmt: skip
    return ok(subject, f"{limit:g}; the loop asks for {wanted.priority}")


def memory_limit(host: Host, wanted: Wanted) -> HostFinding:
    """RLIMIT_MEMLOCK of this shell; the service has its own."""
    subject = "limit memlock"
    if not wanted.lock_memory:
        return ok(subject, "realtime.lock_memory is false")
    if _capable(host, CAP_IPC_LOCK):
        return ok(subject, "this user may lock any memory")
    limit = _limit(host, "Max locked memory")
    if limit is None:
        return warning(subject, "unknown: /proc/self/limits cannot be read", "mount -t proc proc /proc")
    if limit < float("inf"):
        return failure(
            subject, f"{limit / 1024:g} KiB in this shell, the loop locks all it has (the service has its own limit)",
            f"echo '@fffo-drive - memlock unlimited' >> {RT_LIMITS}; usermod -aG fffo-drive $USER; log in again",
        )  # fmt: skip
    return ok(subject, "unlimited")


def _limit(host: Host, name: str) -> float | None:
    line = re.search(rf"^{name}\s+(\S+)", host.text("/proc/self/limits") or "", re.MULTILINE)
    if line is None:
        return None
    return float("inf") if line.group(1) == "unlimited" else float(line.group(1))


def _capable(host: Host, capability: int) -> bool:
    line = re.search(r"^CapEff:\s+([0-9a-f]+)", host.text("/proc/self/status") or "", re.MULTILINE)
    return line is not None and bool(int(line.group(1), 16) >> capability & 1)


def clock(host: Host) -> HostFinding:
    """The clock source: one that is read without a system call."""
    subject = "clock source"
    directory = "/sys/devices/system/clocksource/clocksource0"
    current = host.text(f"{directory}/current_clocksource")
    if current is None:
        return warning(subject, "unknown: not to be read in /sys", "mount -t sysfs sysfs /sys")
    if current in GOOD_CLOCKS:
        return ok(subject, current)
    others = host.text(f"{directory}/available_clocksource") or "none"
    return warning(
        subject, f"{current}: reading the clock takes microseconds (available: {others})",
        "boot with tsc=reliable if dmesg shows no reason why the TSC was given up",
    )  # fmt: skip
