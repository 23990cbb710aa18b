"""Kernels that send a frame and keep the bus state, from errno and error frames."""

from __future__ import annotations

from ...can import frame as can
from ...jit import njit
from ...jit.libc import MSG_DONTWAIT, send
from .port_memory import CONTROLLER_OFF, INTERFACE_OFF, RETURNING, SEND_ATTEMPTS, CanopenPort

ENXIO, ENODEV, ENETDOWN = 6, 19, 100


@njit
def note_bus_state(port: CanopenPort) -> int:
    """Combine the reasons into one flag. Returns it."""
    off = 1 if port.memory[CONTROLLER_OFF] != 0 or port.memory[INTERFACE_OFF] != 0 else 0
    feedback = port.feedback[0]
    if off > feedback["bus_off"]:
        feedback["bus_losses"] += 1
        port.memory[RETURNING] = 1
    feedback["bus_off"] = off
    return off


@njit
def note_errno(port: CanopenPort, result: int) -> int:
    """Derive the interface's state from a failed call. Returns the new bus_off."""
    if result in (-ENETDOWN, -ENODEV, -ENXIO):
        port.memory[INTERFACE_OFF] = 1
    return note_bus_state(port)


@njit
def send_frame(port: CanopenPort, address: int) -> int:
    """Send 16 bytes. Returns 0, or -errno (counted)."""
    # counted first: the link subtracts its own frames from a counter that the kernel raises within send()
    port.memory[SEND_ATTEMPTS] += 1
    n = send(port.tx_fd, address, can.FRAME_SIZE, MSG_DONTWAIT)
    if n == can.FRAME_SIZE:
        if port.memory[INTERFACE_OFF] != 0:
            port.memory[INTERFACE_OFF] = 0
            note_bus_state(port)
        return 0
    port.feedback[0]["send_errors"] += 1
    note_errno(port, n)
    return int(n)
