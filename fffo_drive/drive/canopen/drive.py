"""A CANopen drive behind the drive port: brought up before the loop, served during it, released safely."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from types import TracebackType
from typing import Any, Self

import numpy as np

from ...can import frame as can
from ...can.bpf import CanFilter
from ...can.frame import pack_frame
from ...can.lease import BusHeldError, BusLease
from ...can.link import Link, LinkError, open_link
from ..cia402 import CONTROL_DISABLE_VOLTAGE, STATUS_FAULT
from ..port import (
    NO_LIMIT,
    BusOccupiedError,
    BusUnavailableError,
    CurrentLimit,
    DriveError,
    DriveIdentity,
    DriveRefusedError,
)
from .bring_up import bring_up, start
from .config import ONE_MASTER, CanopenDriveConfig
from .current_limit import read_current_limit
from .cyclic import CanopenPort
from .eds import check_eds, check_identity, load_eds
from .emergency import AskedWords, WarningNews, asked_words, burst_text, standing, statusword_text
from .listening import Listening, foreign_text, masters_frames, state_name
from .object_lengths import lengths_of
from .object_map import CONTROLWORD, STATUSWORD, command_payload
from .port_memory import NO_LINK, SEND_ATTEMPTS, make_port
from .sdo_writes import write_phase
from .service import NMT_PRE_OPERATIONAL, STATE_OPERATIONAL, Emergency, SdoRefusedError, Service, service_filters
from .service_queue import ServiceQueue
from .settings_watch import SettingsWatch
from .silence import release

LOOP_TIMEOUT_PERIODS = 20
LOOP_TIMEOUT_MINIMUM_NS = 20_000_000
SILENT_PERIODS = 5  # without an answer to SYNC, after which the drive's heartbeat is waited for


class CanopenDrive:
    """The `Drive` protocol for a CANopen node, on two links: one for the loop, one for everything else."""

    def __init__(self, config: CanopenDriveConfig) -> None:
        """Raises MappingError if the EDS (if one is given) shows that the drive cannot be used."""
        self.config = config
        self.identity: DriveIdentity | None = None
        self._eds = load_eds(config.eds, config.node_id) if config.eds else None
        if self._eds is not None:
            check_eds(self._eds, config)
        self._lease: BusLease | None = None
        self._listening: Listening | None = None
        self._service: Service | None = None
        self._link: Link | None = None
        self._port: CanopenPort | None = None
        self._limit = NO_LIMIT
        self._lock = threading.Lock()
        self._news = WarningNews(config.warning_codes)
        self._settings: SettingsWatch | None = None
        self._said_state = STATE_OPERATIONAL  # of NMT
        self._said_second = False
        self._connected_ns = 0  # monotonic; what the drive has said before is old

    def listen(self) -> None:
        """Take the lease of the bus and start to listen for other masters; `connect` does it if it was not done
        before.

        Nothing is sent, and the kernel buffers received frames, so that other work can be done before `connect`. Raises
        BusUnavailableError, with the lease released.
        """
        try:
            self._listening = Listening(self.config, self.config.listen_s)
            self._lease = BusLease(self.config.bus)
        except BusHeldError as error:
            self._leave()
            raise BusOccupiedError(f"{error}: {ONE_MASTER}") from error
        except LinkError as error:
            self._leave()
            raise BusUnavailableError(str(error)) from error

    def _refuse_other_masters(self) -> None:
        """Raise BusOccupiedError if another master or a conflicting node was heard."""
        if self._listening is None:
            self.listen()
        assert self._listening is not None
        obstacles = self._listening.heard().obstacles()
        self._listening.close()
        if obstacles:
            found = "; ".join(f"{obstacle.text}: {obstacle.remedy}" for obstacle in obstacles)
            raise BusOccupiedError(f"{self.config.bus}: {found}")

    def connect(self) -> DriveIdentity:
        """Listen, then bring the drive to NMT operational, mapped, verified, not enabled.

        Raises BusUnavailableError (BusOccupiedError before anything was sent) and DriveRefusedError; the bus is left
        then.
        """
        if self._service is not None:
            raise DriveError("connect() was called twice; close() comes in between")
        config = self.config
        loop_timeout_ns = max(LOOP_TIMEOUT_PERIODS * config.period_ns, LOOP_TIMEOUT_MINIMUM_NS)
        queue = ServiceQueue(loop_timeout_ns)
        try:
            self._refuse_other_masters()
            link = open_link(config.bus, filters=service_filters(config.node_id))
            lengths = lengths_of(self._eds, (config.target, config.torque))
            withdrawn = frozenset({(CONTROLWORD, 0), (config.target.index, config.target.sub)})
            self._service = Service(
                link, config.node_id, queue, config.answer_timeout_s, config.attempts, lengths, withdrawn
            )
            identity = bring_up(self._service, config, self._check_identity)
            self._limit = read_current_limit(self._service, config)
            self._link = open_link(config.bus, filters=self._cyclic_filters())
            self._port = make_port(config, self._link, queue.memory)
            start(self._service, config, self._send_sync)
            self._said_state, self._said_second = STATE_OPERATIONAL, False
            self._settings = SettingsWatch(self._service, self._port.feedback)
        except LinkError as error:
            self._leave()
            raise BusUnavailableError(str(error)) from error
        except DriveRefusedError:
            self.close()
            raise
        except BaseException:
            self._leave()
            raise
        self.identity = identity
        self._connected_ns = time.monotonic_ns()
        return identity

    def _check_identity(self, identity: DriveIdentity) -> None:
        if self._eds is not None:
            check_identity(self._eds, identity, str(self.config.eds))

    def _send_sync(self) -> None:
        """Send on the loop's link, before the loop runs."""
        assert self._link is not None
        self._link.send(pack_frame(can.SYNC))

    def _cyclic_filters(self) -> list[CanFilter] | None:
        """The node's frames, and those that only we may send. None on the loopback bus, which counts lost frames only
        without filters.
        """
        if self.config.bus.startswith("loopback:"):
            return None
        identifiers = [pdo.cob_id for pdo in self.config.answers]
        identifiers += [can.EMERGENCY + self.config.node_id, can.HEARTBEAT + self.config.node_id]
        identifiers += [word & can.STANDARD_MASK for word in masters_frames(self.config)]
        return [CanFilter(identifier) for identifier in dict.fromkeys(identifiers)]

    @property
    def port(self) -> CanopenPort:
        """The compiled side; valid between `connect` and `close`."""
        if self._port is None:
            raise DriveError("the drive is not connected: call connect() first")
        return self._port

    @property
    def feedback(self) -> np.ndarray[Any, np.dtype[np.void]]:
        """The port's memory; reading it here updates `dropped_frames`, which the loop cannot."""
        feedback = self.port.feedback
        with self._lock, contextlib.suppress(OSError):
            if self._link is not None:
                feedback["dropped_frames"] = self._link.dropped_frames(self._sent_by_loop)
        result: np.ndarray[Any, np.dtype[np.void]] = feedback
        return result

    def rehearsal_port(self) -> CanopenPort:
        """A port without a link, of the type that `port` will have, to compile the loop before the drive is started."""
        return make_port(self.config, NO_LINK, ServiceQueue(0).memory)

    def _sent_by_loop(self) -> int:
        port = self.port
        return int(port.memory[SEND_ATTEMPTS]) - int(port.feedback["send_errors"][0])

    @property
    def current_limit(self) -> CurrentLimit:
        """As read when the drive was connected."""
        return self._limit

    @property
    def realtime(self) -> bool:
        """Always true: the clock is the wall clock."""
        return True

    @property
    def emergencies(self) -> deque[Emergency]:
        """The last EMCY messages with their vendor bytes, oldest first."""
        return self._connected().emergencies

    def fault_words(self, statusword: int | None = None, ask: bool = True) -> str:
        """All information of the drive on a fault, or on why it is not enabled; empty if it is not connected.

        Frames of somebody else and changed settings, EMCY, the statusword (`statusword`, or the last one received, and
        said to be that). With `ask` it is read anew by SDO, and so are 0x603F, 0x1003, 0x60FD (limit switches,
        interlock) and 0x6079 (DC link), which takes `answer_timeout_s` where nobody answers; a drive that does not
        answer SYNC has the time of a heartbeat to say its NMT state. The newest reason comes first.
        """
        service, port = self._service, self._port
        if service is None:
            return ""
        if statusword is None and port is not None and port.feedback["status_tick"][0] >= 0:
            statusword = int(port.feedback["statusword"][0])
        found, now_ns = self._meddling(), time.monotonic_ns()
        errors, asked = self._errors(service, statusword, now_ns), AskedWords([], [], [])
        now: int | None = None
        if ask:
            with contextlib.suppress(DriveError):
                now = self._read_statusword(service)
                errors = self._errors(service, statusword if now is None else now, now_ns)
                asked = asked_words(service, [one.code for one in errors])
            found += self._nmt_words(service)
        unserved = self.config.unserved_status_bits
        states = [] if now is None else [statusword_text(now, unserved)]
        if statusword is not None and statusword != now:
            states.append(statusword_text(statusword, unserved, "last statusword received"))
        return "; ".join([*found, *burst_text(errors, now_ns), *asked.error, *states, *asked.supplies, *asked.history])

    def _errors(self, service: Service, statusword: int | None, now_ns: int) -> list[Emergency]:
        """EMCY that may be the reason, newest first: those from before the connection only of a drive in fault."""
        errors = standing(list(service.emergencies), self.config.warning_codes, now_ns)
        since = [one for one in errors if one.monotonic_ns >= self._connected_ns]
        return since if since or (statusword is not None and not statusword & STATUS_FAULT) else errors

    def _meddling(self) -> list[str]:
        """What somebody else has sent in our name, or changed in the drive."""
        if self._port is None:
            return []
        feedback, changed = self._port.feedback, self._settings.changed if self._settings is not None else []
        foreign = int(feedback["foreign_frames"][0])
        sender = [f"{foreign_text(self.config, int(feedback['foreign_id'][0]))} from somebody else"] if foreign else []
        return [*sender, *changed]

    def _read_statusword(self, service: Service) -> int | None:
        """As it is now: None where the drive refuses. Raises DriveError, sooner than other reads."""
        try:
            return int.from_bytes(service.read(STATUSWORD, 0, attempts=2)[:2], "little")
        except SdoRefusedError:
            return None

    def _nmt_words(self, service: Service) -> list[str]:
        """The NMT state, where it is not operational."""
        if self._port is not None:
            age_ns = time.monotonic_ns() - int(self._port.feedback["received_ns"][0])
            if age_ns > SILENT_PERIODS * self.config.period_ns:  # it says so with its next heartbeat
                wait_s = 2e-3 * self.config.drive_heartbeat_ms
                service.wait_until(lambda: service.nmt_state != STATE_OPERATIONAL, wait_s)
        if service.nmt_state in (STATE_OPERATIONAL, -1):
            return []
        return [f"NMT state {state_name(service.nmt_state)} (its heartbeat)"]

    def warnings(self) -> list[str]:
        """News of the drive since the last call that stop nothing by themselves, one sentence each; never waits."""
        service, port = self._service, self._port
        if service is None or port is None:
            return []
        statusword = int(port.feedback["statusword"][0])
        found = self._news.look(list(service.emergencies), statusword, time.monotonic_ns())
        found += self._settings.news() if self._settings is not None else []
        if port.feedback["duplicate_feedback"][0] and not self._said_second:
            self._said_second = True
            what = foreign_text(self.config, int(port.feedback["foreign_id"][0]))
            found.append(f"{what} twice after one SYNC: somebody else sends it, or the bus repeats frames")
        if service.nmt_state not in (self._said_state, -1):
            self._said_state = service.nmt_state
            found.append(f"the drive's heartbeat says: {state_name(service.nmt_state)}")
        return found

    def read_object(self, index: int, sub: int) -> bytes:
        """Read an object of the drive by SDO, at any time, from any thread but the loop's.

        Raises SdoRefusedError (a DriveRefusedError) and BusUnavailableError.
        """
        return self._connected().read(index, sub)

    def _connected(self) -> Service:
        if self._service is None:
            raise DriveError("the drive is not connected: call connect() first")
        return self._service

    def close(self, loop_ended: bool = True) -> None:
        """Release the drive after the loop: no torque, no voltage, pre-operational. Never raises.

        The drive is also told to stop monitoring our heartbeat, as an orderly release is not a fault. A node to which
        nothing was written is left alone: it may be another device. `loop_ended` False: the loop's link stays open, so
        that a descriptor to which a hung thread may still write is not reused.
        """
        service, link = self._service, self._link
        if self._settings is not None:
            self._settings.close()
        if service is not None and service.has_written:
            service.send_directly()
            if link is not None:
                with contextlib.suppress(LinkError):
                    link.send(
                        pack_frame(self.config.command.cob_id, command_payload(self.config.command, self.config.mode))
                    )
                    link.send(pack_frame(can.SYNC))
            with contextlib.suppress(BusUnavailableError):  # a silent drive is not asked three times
                target = self.config.target
                for index, sub, data in (
                    (target.index, target.sub, bytes(target.bits // 8)),
                    (CONTROLWORD, 0, CONTROL_DISABLE_VOLTAGE.to_bytes(2, "little")),
                ):
                    with contextlib.suppress(DriveRefusedError):
                        service.write(index, sub, data)
                with contextlib.suppress(DriveRefusedError):
                    release(service, self.config)
                with contextlib.suppress(DriveRefusedError):
                    write_phase(service, self.config.sdo, "after_disable")
            with contextlib.suppress(BusUnavailableError):
                service.command_nmt(NMT_PRE_OPERATIONAL)
        self._leave(loop_ended)

    def _leave(self, loop_ended: bool = True) -> None:
        if self._settings is not None:
            self._settings.close()
        self._settings = None
        if self._service is not None:
            self._service.close()
        self._service = None
        if not loop_ended:
            return
        if self._link is not None:
            with self._lock, contextlib.suppress(OSError):
                self._link.close()
        for held in (self._listening, self._lease):
            if held is not None:
                held.close()
        self._link = self._port = self._listening = self._lease = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
