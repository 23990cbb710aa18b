"""The CPU of the loop: which one, isolated or not, its frequency, its idle states and its interrupts."""

from __future__ import annotations

import re
from typing import NamedTuple

from .findings import HostFinding, Wanted, failure, ok, warning
from .host import Host, cpu_list

SYSTEM = "/sys/devices/system/cpu"
LONGEST_WAKE_SHARE = 0.1  # of the period, from an idle state
NAMED_INTERRUPTS = 3


class Chosen(NamedTuple):
    """The CPU that the loop's thread will be pinned to."""

    cpu: int | None  # None: not pinned, or unknown
    allowed: set[int]
    isolated: set[int]


def choose_cpu(host: Host, wanted: Wanted) -> Chosen:
    """As `runtime.realtime` chooses it."""
    line = re.search(r"^Cpus_allowed_list:\s+(\S+)", host.text("/proc/self/status") or "", re.MULTILINE)
    allowed = cpu_list(line.group(1) if line else None)
    isolated = cpu_list(host.text(f"{SYSTEM}/isolated"))
    cpu = wanted.cpu if wanted.cpu >= 0 else (max(allowed, default=None) if wanted.cpu == -1 else None)
    return Chosen(cpu, allowed, isolated)


def processor_findings(host: Host, wanted: Wanted) -> list[HostFinding]:
    """All about the loop's CPU."""
    chosen = choose_cpu(host, wanted)
    findings = [placement(host, wanted, chosen)]
    if chosen.cpu is not None:
        findings += [
            isolation(host, chosen.cpu, chosen),
            frequency(host, chosen.cpu),
            idle_states(host, chosen.cpu, wanted),
            interrupts(host, chosen.cpu, wanted),
        ]
    return findings


def placement(host: Host, wanted: Wanted, chosen: Chosen) -> HostFinding:
    """Which CPU, and whether there is another one for the rest."""
    subject = "cpu"
    online = cpu_list(host.text(f"{SYSTEM}/online"))
    count = f"{len(online)} online" if online else "number of CPUs unknown"
    if wanted.cpu == -2:
        return warning(subject, f"not pinned (realtime.cpu: any), {count}", "realtime.cpu: last in the axis file")
    if chosen.cpu is None:
        return warning(subject, "unknown: /proc/self/status cannot be read", "mount -t proc proc /proc")
    if online and chosen.cpu not in online:
        return failure(
            subject, f"CPU {chosen.cpu} (realtime.cpu) is not there: {host.text(f'{SYSTEM}/online')} are online",
            f"realtime.cpu: {max(online)} in the axis file",
        )  # fmt: skip
    if len(online) == 1:
        return warning(
            subject, "one CPU: the loop shares it with everything else", "use a machine with two cores or more"
        )
    spare = sorted(chosen.isolated - {chosen.cpu})
    if chosen.cpu not in chosen.isolated and spare:
        return warning(
            subject, f"CPU {chosen.cpu}, although CPU {_shown(set(spare))} is isolated ('last' takes no isolated one)",
            f"realtime.cpu: {spare[-1]} in the axis file",
        )  # fmt: skip
    return ok(subject, f"CPU {chosen.cpu} for the loop, {count}")


def isolation(host: Host, cpu: int, chosen: Chosen) -> HostFinding:
    """Whether the scheduler keeps other programs off the CPU and its hyper-thread."""
    subject = "isolation"
    siblings = cpu_list(host.text(f"{SYSTEM}/cpu{cpu}/topology/thread_siblings_list")) | {cpu}
    wanted = ",".join(str(one) for one in sorted(siblings))
    remedy = (
        f"boot with isolcpus=managed_irq,domain,{wanted} nohz_full={wanted} rcu_nocbs={wanted}; "
        f"realtime.cpu: {cpu} in the axis file"
    )
    if cpu not in chosen.isolated:
        return warning(subject, f"CPU {cpu} is not isolated: other programs run on it", remedy)
    shared = siblings - chosen.isolated
    if shared:
        return warning(subject, f"CPU {cpu} is isolated, its hyper-thread CPU {_shown(shared)} is not", remedy)
    ticking = siblings - cpu_list(host.text(f"{SYSTEM}/nohz_full"))
    tail = "" if not ticking else "; the timer tick still runs there (nohz_full)"
    return ok(subject, f"CPU {_shown(siblings)} isolated{tail}")


def frequency(host: Host, cpu: int) -> HostFinding:
    """The frequency governor."""
    subject = "governor"
    governor = host.text(f"{SYSTEM}/cpu{cpu}/cpufreq/scaling_governor")
    if governor is None:
        return ok(subject, f"CPU {cpu}: no frequency scaling by the kernel")
    if governor == "performance":
        return ok(subject, f"CPU {cpu}: performance")
    return warning(
        subject, f"CPU {cpu}: {governor}: its frequency follows a load that the loop does not make",
        f"cpupower -c {cpu} frequency-set -g performance (package linux-cpupower)",
    )  # fmt: skip


def idle_states(host: Host, cpu: int, wanted: Wanted) -> HostFinding:
    """Idle states that take long to wake from."""
    subject = "idle states"
    directory = f"{SYSTEM}/cpu{cpu}/cpuidle"
    deepest_us, name = 0, ""
    for state in (found for found in host.names(directory) if found.startswith("state")):
        latency_us = host.number(f"{directory}/{state}/latency") or 0
        if host.number(f"{directory}/{state}/disable") != 1 and latency_us > deepest_us:
            deepest_us, name = latency_us, host.text(f"{directory}/{state}/name") or state
    bound_us = round(LONGEST_WAKE_SHARE * wanted.period_us)
    if deepest_us > bound_us:
        return warning(
            subject, f"CPU {cpu}: {name} takes {deepest_us} us to wake from, the period is {wanted.period_us:g} us",
            f"cpupower -c {cpu} idle-set -D {bound_us}",
        )  # fmt: skip
    return ok(subject, f"CPU {cpu}: {f'{name}, {deepest_us} us to wake' if name else 'none that delays'}")


def interrupts(host: Host, cpu: int, wanted: Wanted) -> HostFinding:
    """Interrupts of devices that came to the CPU and are still led there. The bus's own may: the loop waits for it."""
    subject = "interrupts"
    table = host.text("/proc/interrupts")
    if table is None:
        return warning(subject, "unknown: /proc/interrupts cannot be read", "mount -t proc proc /proc")
    own = (wanted.bus or "").partition(":")[2]
    found = sorted((one for one in _interrupts_on(host, table, cpu) if one[2] != own), reverse=True)
    if not found:
        return ok(subject, f"none of a device on CPU {cpu}")
    named = ", ".join(f"{number} ({name}: {count})" for count, number, name in found[:NAMED_INTERRUPTS])
    more = f" and {len(found) - NAMED_INTERRUPTS} more" if len(found) > NAMED_INTERRUPTS else ""
    elsewhere = _listed(sorted(cpu_list(host.text(f"{SYSTEM}/online")) - {cpu}) or [0])
    return warning(
        subject, f"{len(found)} of devices on CPU {cpu}: {named}{more}",
        f"echo {elsewhere} > /proc/irq/{found[0][1]}/smp_affinity_list for each, or boot with irqaffinity={elsewhere}",
    )  # fmt: skip


def _interrupts_on(host: Host, table: str, cpu: int) -> list[tuple[int, int, str]]:
    """(count, number, name) of device interrupts that the CPU has taken and still takes."""
    head, _, lines = table.partition("\n")
    heads = head.split()
    if f"CPU{cpu}" not in heads:
        return []
    column = heads.index(f"CPU{cpu}")
    found = []
    for line in lines.splitlines():
        number, _, rest = line.partition(":")
        words = rest.split()
        if not number.strip().isdigit() or len(words) <= len(heads):
            continue
        count = int(words[column])
        places = host.text(f"/proc/irq/{number.strip()}/effective_affinity_list")
        if count > 0 and (places is None or cpu in cpu_list(places)):
            found.append((count, int(number), words[-1]))
    return found


def _shown(cpus: set[int]) -> str:
    return ", ".join(str(cpu) for cpu in sorted(cpus))


def _listed(cpus: list[int]) -> str:
    """As the kernel reads it: ranges where they are whole."""
    whole = cpus == list(range(cpus[0], cpus[-1] + 1)) and len(cpus) > 1
    return f"{cpus[0]}-{cpus[-1]}" if whole else ",".join(str(cpu) for cpu in cpus)
