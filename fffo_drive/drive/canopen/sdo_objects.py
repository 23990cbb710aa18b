"""Objects of a drive, read by SDO: each once, with its value or why there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ..port import BusUnavailableError
from .object_map import object_name
from .service import SdoAnswerError, SdoRefusedError

Read = Callable[[int, int], bytes]  # raises SdoRefusedError, SdoAnswerError, BusUnavailableError

NO_DATA = 0x08000024  # abort code of an object that exists but is empty, such as 0x1003:01 without errors
MOST_TIMEOUTS = 3  # SDO timeouts in a row after which the drive counts as gone
# uploaded from every drive first (CiA 301, CiA 402-2)
WANTED: tuple[tuple[int, int], ...] = (
    (0x1000, 0), (0x1001, 0), (0x1003, 0), (0x1003, 1), (0x1003, 2), (0x1003, 3), (0x1005, 0), (0x100C, 0), (0x100D, 0),
    (0x1014, 0), (0x1016, 1), (0x1017, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4), (0x1029, 1),
    (0x1400, 1), (0x1400, 2), (0x1400, 5), (0x1800, 1), (0x1800, 2), (0x1801, 1), (0x1801, 2), (0x1802, 1), (0x1802, 2),
    (0x1802, 3), (0x6007, 0), (0x603F, 0), (0x6041, 0), (0x605A, 0), (0x605E, 0), (0x6061, 0), (0x6064, 0), (0x606C, 0),
    (0x6071, 0), (0x6072, 0), (0x6073, 0), (0x6075, 0), (0x6076, 0), (0x6077, 0), (0x6079, 0), (0x607E, 0), (0x6080, 0),
    (0x608F, 1), (0x608F, 2), (0x6090, 1), (0x6090, 2), (0x6091, 1), (0x6091, 2), (0x6092, 1), (0x6092, 2),
    (0x60A8, 0), (0x60A9, 0), (0x60C2, 1), (0x60C2, 2), (0x60E0, 0), (0x60E1, 0), (0x60FD, 0), (0x60FE, 1),
    (0x6502, 0), (0x6841, 0),
)  # fmt: skip
CHANGING = (0x1001, 0x603F, 0x6041, 0x6061, 0x6079, 0x60FD, 0x60FE)  # read again once SYNC has run


class SdoObjects:
    """`DriveObjects` of a drive on the bus: uploaded by SDO when first asked for.

    `most_timeouts`: requests in a row without their answer after which the error is raised.
    """

    def __init__(self, read: Read, most_timeouts: int = MOST_TIMEOUTS) -> None:
        self._read: Read | None = read
        self._most_timeouts = most_timeouts
        self._known: dict[tuple[int, int], tuple[bool, int | None]] = {}
        self._timeouts = 0
        self.unreadable: dict[str, str] = {}  # objects that exist, or may exist, but have no value: the reason

    def has(self, index: int, sub: int = 0) -> bool:
        """False where the drive reports that it lacks the object. Raises BusUnavailableError."""
        return self._upload(index, sub)[0]

    def value(self, index: int, sub: int = 0) -> int | None:
        """Unsigned, of whatever size. Raises BusUnavailableError."""
        return self._upload(index, sub)[1]

    def mappable(self, index: int, sub: int = 0) -> bool:
        """A drive says so when the PDO is mapped. Raises BusUnavailableError."""
        return self.has(index, sub)

    def read_all(self, progress: Callable[[float], None] = lambda share: None) -> None:
        """Read all of WANTED; `progress` gets the fraction done."""
        for k, (index, sub) in enumerate(WANTED, 1):
            self._upload(index, sub)
            progress(k / len(WANTED))

    def read_again(self, read: Read, indices: Iterable[int] = CHANGING) -> None:
        """Read these objects again by another route; an object without an answer keeps its earlier value."""
        wanted = set(indices)
        before = dict(self._known)
        self._read, self._timeouts = read, 0
        try:
            for where in [where for where in before if where[0] in wanted]:
                del self._known[where]
                self._upload(*where)
        except (BusUnavailableError, SdoAnswerError):
            self._known = {**before, **self._known}
        self._read = None

    def stop_reading(self) -> None:
        """The connection is closed: objects not read yet count as absent."""
        self._read = None

    @property
    def values(self) -> dict[str, int]:
        """0x6041:00 -> number, for all objects read."""
        return {object_name(*where): value for where, (_, value) in sorted(self._known.items()) if value is not None}

    def _upload(self, index: int, sub: int) -> tuple[bool, int | None]:
        where = index, sub
        if self._read is None:
            return self._known.get(where, (False, None))
        if where not in self._known:
            self.unreadable.pop(object_name(*where), None)
            try:
                data = self._read(index, sub)
                self._known[where] = True, int.from_bytes(data, "little")
                self._timeouts = 0
            except SdoRefusedError as refusal:
                self._known[where] = not refusal.absent, None
                self._timeouts = 0
                if not refusal.absent and refusal.code != NO_DATA:
                    self.unreadable[object_name(*where)] = f"abort 0x{refusal.code:08X}"
            except (BusUnavailableError, SdoAnswerError) as error:
                self._timeouts += 1
                if self._timeouts >= self._most_timeouts:
                    raise
                self._known[where] = True, None
                answers = isinstance(error, SdoAnswerError)
                self.unreadable[object_name(*where)] = "a wrong answer" if answers else "no answer"
        return self._known[where]
