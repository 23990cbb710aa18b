"""The loopback bus as a python-can interface: python-can's tools and `canopen` work on it.

Registered as `fffo_loopback` (entry point can.interface): `can.Bus(interface="fffo_loopback", channel=20000)`
in a program, `python -m can.viewer -i fffo_loopback -c 20000` in a terminal.
"""

from __future__ import annotations

from typing import Any

import can

from .bpf import CanFilter
from .frame import EXTENDED_FLAG, Frame, pack_frame, unpack_frame
from .link import LinkError, StampedFrame, open_link


def kernel_filters(filters: Any) -> list[CanFilter]:
    """python-can's filter dictionaries (can_id, can_mask, optional extended) as kernel filters."""
    converted = []
    for item in filters or ():
        can_id, mask = int(item["can_id"]), int(item["can_mask"])
        if "extended" in item:
            mask |= EXTENDED_FLAG
            can_id |= EXTENDED_FLAG if item["extended"] else 0
        converted.append(CanFilter(can_id, mask))
    return converted


class LoopbackBus(can.BusABC):
    """A loopback bus; `channel` is its UDP port. Filters work in the kernel, timestamps come from there.

    Raises can.CanInitializationError when the port cannot be used, can.CanOperationError on send and receive.
    """

    def __init__(
        self,
        channel: Any,
        can_filters: Any = None,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        try:
            self._link = open_link(f"loopback:{channel}", receive_own=bool(receive_own_messages))
        except LinkError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel = channel
        self.channel_info = f"loopback bus on UDP port {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            received = self._link.receive_stamped(3600.0 if timeout is None else timeout)
        except LinkError as error:
            raise can.CanOperationError(str(error)) from error
        return (None if received is None else self._as_message(received)), True

    def _as_message(self, received: StampedFrame) -> can.Message:
        frame: Frame = unpack_frame(received.raw)
        return can.Message(
            timestamp=received.time_s,
            arbitration_id=frame.can_id,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_error_frame=frame.error,
            dlc=len(frame.data),
            data=None if frame.remote else frame.data,
            channel=str(self.channel),
            is_rx=not received.own,
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one classic frame. The loopback bus never makes the sender wait: `timeout` does not matter."""
        if msg.is_fd:
            raise can.CanOperationError("the loopback bus carries classic CAN frames, no CAN FD")
        data = bytes(msg.dlc) if msg.is_remote_frame else bytes(msg.data)
        raw = pack_frame(
            msg.arbitration_id,
            data,
            extended=msg.is_extended_id,
            remote=msg.is_remote_frame,
            error=msg.is_error_frame,
        )
        try:
            self._link.send(raw)
        except LinkError as error:
            raise can.CanOperationError(str(error)) from error

    def _apply_filters(self, filters: Any) -> None:
        try:
            self._link.set_filters(kernel_filters(filters))
        except (LinkError, ValueError) as error:
            raise can.CanOperationError(str(error)) from error

    def fileno(self) -> int:
        """Descriptor that becomes readable with a frame."""
        return self._link.rx_fd

    def shutdown(self) -> None:
        """Stop periodic tasks and leave the bus."""
        super().shutdown()
        self._link.close()
