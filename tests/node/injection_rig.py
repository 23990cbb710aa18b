"""A drive that turns on a cyclic connection, and faults injected into it by object 0x2100."""

from __future__ import annotations

from node.node_rig import OPERATION_ENABLED, Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import FaultKind

FAULT, FRA, SOD = 0x08, 0x0F, 0x40
FOREVER = 0


def inject(
    rig: Rig, kind: FaultKind, *, can_id: int = 0, share: int = 1000, value: int = 0, ms: int = FOREVER, jitter: int = 0
) -> list[str]:
    """By object 0x2100. Returns what the node sends when the fault begins."""
    steps = ((1, kind, 1), (2, can_id, 4), (3, share, 2), (4, value, 4), (5, ms, 4), (8, jitter, 4), (6, 1, 1))
    for sub, number, size in steps:
        assert rig.write(0x2100, sub, number, size) == 0
    return rig.wait(0)


def clear(rig: Rig) -> None:
    assert rig.write(0x2100, 6, 2, 1) == 0
    assert rig.read(0x2100, 7) == 0


def flat(seen: list[list[str]]) -> list[str]:
    return [name for each in seen for name in each]


def turning(config: NodeConfig | None = None, deadline_ms: int = 20) -> Rig:
    """Mapped as the controller maps it, enabled in the cyclic mode, 5 rev/s, no target. RPDO deadline set."""
    rig = Rig(config)
    rig.map_cyclic()
    for sub, value, size in ((1, 0x80000201, 4), (5, deadline_ms, 2), (1, 0x201, 4)):
        assert rig.write(0x1400, sub, value, size) == 0
    rig.operational()
    assert rig.write(0x6060, 0, 10, 1) == 0
    for word in (0x00, 0x06, 0x07, 0x0F, 0x0F):
        rig.cycle(word, 0)
    assert rig.state == OPERATION_ENABLED
    rig.plant.velocity_rps = 5.0
    return rig


def identifiers(frames: list[str]) -> list[str]:
    return [frame.partition("#")[0] for frame in frames]


def cycles(rig: Rig, count: int, torque: int = 0) -> list[list[str]]:
    return [identifiers(rig.cycle(0x0F, torque)) for _ in range(count)]
