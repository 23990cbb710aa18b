"""Who commands on the bus of an axis, heard while other things are looked at. Nothing is sent."""

from __future__ import annotations

from ..can.lease import bus_holder
from ..can.link import LinkError
from ..drive.canopen.config import ONE_MASTER, CanopenDriveConfig
from ..drive.canopen.listening import Listening
from .findings import HostFinding, failure, ok, warning

SUBJECT = "bus master"


class BusMasters:
    """Hears from its making until `findings` is asked for, and for `listen_s` at least."""

    def __init__(self, config: CanopenDriveConfig, listen_s: float) -> None:
        self._config = config
        self._listen_s = listen_s
        self._listening: Listening | LinkError
        try:
            self._listening = Listening(config, listen_s)
        except LinkError as error:
            self._listening = error

    def findings(self) -> list[HostFinding]:
        """Who was there."""
        bus = self._config.bus
        try:
            if isinstance(self._listening, LinkError):
                raise self._listening
            heard = self._listening.heard()
            self._listening.close()
        except LinkError as error:
            return [failure(SUBJECT, str(error), "see what is said of its interface")]
        nodes = f"heartbeats of nodes: {', '.join(map(str, sorted(heard.nodes))) or 'none'}"
        holder = bus_holder(bus)
        if holder is not None:
            text = f"{holder} on this machine commands on {bus}; {nodes}"
            return [warning(SUBJECT, text, f"fffo-drive ctl status, if it is a daemon. {ONE_MASTER}")]
        obstacles = heard.obstacles()
        if obstacles:
            return [failure(SUBJECT, f"{bus}: {obstacle.text}", obstacle.remedy) for obstacle in obstacles]
        return [ok(SUBJECT, f"{bus}: nobody else was heard to command in {self._listen_s:g} s; {nodes}")]
