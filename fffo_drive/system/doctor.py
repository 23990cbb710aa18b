"""Everything that the doctor looks at, in the order in which it is to be read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

from .bus import bus_findings
from .findings import HostFinding, Severity, Wanted
from .host import Host
from .kernel import kernel_findings
from .processor import processor_findings


def examine(host: Host, wanted: Wanted) -> list[HostFinding]:
    """Findings that come from reading alone: kernel, CPU of the loop, bus."""
    return [*kernel_findings(host, wanted), *processor_findings(host, wanted), *bus_findings(host, wanted)]


def counts(findings: Iterable[HostFinding]) -> dict[Severity, int]:
    """How many findings of each level."""
    levels = [finding.level for finding in findings]
    return {level: levels.count(level) for level in Severity}


def as_text(findings: Sequence[HostFinding]) -> str:
    """One line a finding, and below it what to type."""
    width = max((len(finding.subject) for finding in findings), default=0)
    lines = []
    for finding in findings:
        lines.append(f"{finding.level:<8} {finding.subject:<{width}}  {finding.text}")
        if finding.remedy:
            lines.append(f"{'':<8} {'':<{width}}    -> {finding.remedy}")
    found = counts(findings)
    failures, warnings = found[Severity.FAILURE], found[Severity.WARNING]
    plural = ("s" if failures != 1 else "", "s" if warnings != 1 else "")
    lines.append(f"{failures} failure{plural[0]}, {warnings} warning{plural[1]}, {found[Severity.OK]} ok")
    return "\n".join(lines)


def as_json(findings: Sequence[HostFinding]) -> str:
    """One object: `findings` (subject, level, text, remedy) and `counts` by level."""
    found = [finding._asdict() for finding in findings]
    return json.dumps({"findings": found, "counts": {str(k): v for k, v in counts(findings).items()}}, indent=2)
