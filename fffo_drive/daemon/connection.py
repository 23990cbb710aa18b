"""A drive with a running loop: brought up and released, both on a thread that may wait for the bus."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..config.drive_section import CanopenDriveSection
from ..control.envelope import TRIP_NONE
from ..documents import refuse
from ..drive.canopen.drive import CanopenDrive
from ..drive.cia402 import GOAL_DISABLED, STATE_FAULT, STATE_FAULT_REACTION_ACTIVE, state_of
from ..drive.port import Drive, DriveIdentity
from ..runtime import blocks as b
from ..runtime.realtime import RealtimeReport
from ..runtime.ring import HEAD, copy_row
from ..runtime.session import LoopHungError, OnPaper, Session
from ..workflows.plan import Plan, plan_session


@dataclasses.dataclass
class Connection:
    """A drive and its loop; SYNC runs, without torque until it is requested."""

    number: int  # from 1, in the life of the daemon
    drive: Drive
    identity: DriveIdentity
    session: Session
    realtime: RealtimeReport

    @property
    def running(self) -> bool:
        """Whether the loop's thread is alive."""
        return self.session.running

    @property
    def head(self) -> int:
        """Rows ever written by the loop."""
        return int(self.session.ring.words[HEAD])

    def last_row(self) -> np.void | None:
        """A copy of the newest row; None before the first."""
        rows = self.last_rows(1)
        return rows[0] if rows else None

    def last_rows(self, count: int) -> list[np.void]:
        """Copies of the newest rows, oldest first; fewer where the loop has just begun."""
        head = self.head
        return [copy_row(self.session.ring, number) for number in range(max(0, head - count), head)]

    def beat(self) -> None:
        """Tell the loop that the supervisor is alive."""
        words = self.session.blocks.control
        self.session.request(b.SUPERVISOR_BEAT, int(words[b.SUPERVISOR_BEAT]) + 1)

    def in_fault(self) -> bool:
        """Whether the drive itself is in a fault state."""
        return state_of(self.session.status(b.STATUSWORD)) in (STATE_FAULT, STATE_FAULT_REACTION_ACTIVE)

    @property
    def trip(self) -> int:
        """The latched trip (envelope.TRIP_*)."""
        return self.session.status(b.TRIP)

    @property
    def last_tick(self) -> int:
        """Tick of the latched trip; without one, the last that the loop ran."""
        return self.session.status(b.TICK if self.trip == TRIP_NONE else b.TRIP_TICK)

    @property
    def clear(self) -> bool:
        """Whether no fault is latched, neither here nor in the drive."""
        return self.trip == TRIP_NONE and not self.in_fault()


def require_served(plan: Plan) -> None:
    """Raise DocumentError if the axis cannot be served."""
    if not isinstance(plan.axis.drive, CanopenDriveSection):
        text = (
            "a daemon needs a drive on a bus; for the simulated one run `fffo-drive sim` beside it and give "
            "kind: canopen with its bus (configs/axis_canopen.yaml)"
        )
        refuse(plan.path, [("drive.kind", text)])


def bring_up(plan: Plan, number: int, drive: Drive) -> Connection:
    """Connect, compile, start the loop. Raises DriveError, LinkError, RealtimeRefusedError, with the bus released."""
    try:
        if isinstance(drive, CanopenDrive):
            drive.listen()  # goes on while the loop is compiled
            Session.rehearse(OnPaper(drive.rehearsal_port()), plan_session(plan))
        identity = drive.connect()
        config = plan_session(plan)
        rate_hz = plan.axis.loop.rate_hz
        loop = config.loop._replace(supervisor_ticks=round(plan.axis.daemon.supervisor_timeout_s * rate_hz))
        longest = round(plan.axis.loop.longest_profile_s * rate_hz)
        session = Session(drive, config._replace(loop=loop, longest_profile=longest))
        session.request(b.GOAL, GOAL_DISABLED)
        session.request(b.TOGGLE, plan.toggle)
        report = session.start()
    except BaseException:
        drive.close()
        raise
    return Connection(number, drive, identity, session, report)


def leave(connection: Connection) -> LoopHungError | None:
    """End the loop, then leave the drive without torque. Return the reason if the service cannot continue after it."""
    try:
        connection.session.close()
    except LoopHungError as error:
        return error
    return None
