"""What the drive was told, read again while the loop runs: a setting that somebody changes is a fault.

The list is what the bring-up has written and read back (`Service.kept`): PDOs, mode, reaction to a silent PC, and the
checked objects of drive.sdo. One object at a time, in turn; SDO goes out in the loop's slot, after the command.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from ..port import DriveError
from .object_map import object_name
from .service import SdoRefusedError, Service, shown_value

REREAD_S = 0.1  # between two objects: some forty of them take four seconds
END_S = 1.0  # for a read that is under way


class SettingsWatch:
    """Reads on a thread of its own until `close`. A change is counted in `settings_changed` of the port's feedback."""

    def __init__(self, service: Service, feedback: np.ndarray[Any, np.dtype[np.void]]) -> None:
        self.changed: list[str] = []  # object, what it should be and what it is
        self._news: list[str] = []
        self._service, self._feedback = service, feedback
        self._turn = list(service.kept)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._live, name="fffo-settings", daemon=True)
        self._thread.start()

    def _live(self) -> None:
        while self._turn and not self._closing.wait(REREAD_S):
            if self._service.queue.loop_runs:
                self.look()

    def look(self) -> None:
        """Read the next object."""
        where = self._turn.pop(0)
        kept, name = self._service.kept[where], object_name(*where)
        try:
            read = int.from_bytes(self._service.read(*where, attempts=1)[: kept.size], "little")
        except SdoRefusedError as refusal:
            self._news.append(f"{name} cannot be watched: {refusal}")
            return
        except DriveError:  # silence is noticed elsewhere
            self._turn.append(where)
            return
        if kept.is_still(read):
            self._turn.append(where)
            return
        found, told = shown_value(read, kept.size), shown_value(kept.value, kept.size)
        self.changed.append(f"{name} is {found}, but was told {told}, needed for {kept.purpose}")
        self._feedback["settings_changed"] += 1

    def news(self) -> list[str]:
        """What cannot be watched, each once."""
        said, self._news = self._news, []
        return said

    def close(self) -> None:
        """Stop reading; never raises."""
        self._closing.set()
        self._thread.join(END_S)
