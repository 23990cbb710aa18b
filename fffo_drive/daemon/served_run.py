"""A run on a drive that a daemon has: the daemon moves the axis and records; the file is put where it is wanted.

Nothing here opens the bus. What the axis was before (torque, friction, a recording in progress) it is again afterwards.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ..workflows.errors import DriveFaultError
from ..workflows.progress import Bar, no_bar
from .client import CallError, DaemonClient
from .places import CONTROL

POLL_S = 0.1
END_S = 15.0  # to standstill, and for a file to be closed
AT_WORK = ("preparing", "running")
STARTED = ("ready", "enabled")


def record_served(
    directory: Path, profile: str | dict[str, Any], toggle: str | None, out: Path, who: str | None = None,
    bar: Bar = no_bar, sleep: Callable[[float], None] = time.sleep,
) -> list[Path]:  # fmt: skip
    """Ask the daemon on the sockets in `directory` to run a profile and record it. Returns the files, `out` first.

    `profile`: a name that it knows, or a section as in an axis file. An interrupt brakes to standstill. Raises
    CallError, ClientError, DriveFaultError where a fault or somebody's stop ended the run, OSError for the copy.
    """
    asker = {} if who is None else {"who": who}
    with DaemonClient(directory / CONTROL) as client, contextlib.ExitStack() as afterwards:
        before = client.call("status")
        if before["state"] not in STARTED:
            reasons = "; ".join(before["obstacles"]) or (before["fault"] or {}).get("text", "")
            raise DriveFaultError(
                f"the daemon has the axis in state {before['state']}{f' ({reasons})' if reasons else ''}; "
                f"a run begins from {' or '.join(STARTED)}"
            )
        if toggle is not None and toggle != before["toggle"]:
            client.call("toggle", to=toggle, **asker)
            afterwards.callback(client.call, "toggle", to=before["toggle"], **asker)
        epoch = before["epoch"]
        if before["state"] == "ready":
            afterwards.callback(_to_rest, client, "disable", asker)
            epoch = client.call("enable", epoch=epoch, **asker)["epoch"]
        with own_recording(client, asker) as files:
            ended = _run(client, profile, epoch, asker, bar, sleep)
    placed = _placed(files, out)
    if ended:
        raise DriveFaultError(f"the run ended early: {ended}; recorded: {', '.join(map(str, placed)) or 'nothing'}")
    return placed


@contextlib.contextmanager
def own_recording(client: DaemonClient, asker: dict[str, str]) -> Iterator[list[Path]]:
    """Record in files of their own, which the list has afterwards; one in progress ends before and begins again after.

    Raises CallError, ClientError.
    """
    files: list[Path] = []
    in_progress = client.call("status")["recording"]["on"]
    if in_progress:
        client.call("record", to="off", **asker)
    client.call("record", to="on", **asker)
    try:
        yield files
    finally:
        files += [Path(file) for file in client.call("record", to="off", **asker)["files"]]
        if in_progress:
            client.call("record", to="on", **asker)


def _run(
    client: DaemonClient, profile: str | dict[str, Any], epoch: int, asker: dict[str, str], bar: Bar,
    sleep: Callable[[float], None],
) -> str:  # fmt: skip
    """Start, and watch until it has ended. Returns why it ended early; empty where it did not."""
    client.call("start", profile=profile, epoch=epoch, **asker)
    done = 0.0
    name = profile if isinstance(profile, str) else str(profile["kind"])
    with bar(f"{name}, by the daemon") as progress:
        try:
            while (status := client.call("status"))["state"] in AT_WORK:
                if status["profile"] is not None:
                    done = max(0.0, status["profile"]["sample"]) / max(1, status["profile"]["samples"])
                    if progress is not None:
                        progress(done)
                sleep(POLL_S)
        except KeyboardInterrupt:
            _to_rest(client, "stop", asker)
            raise
    if status["fault"]:
        return str(status["fault"]["text"])
    return "" if status["epoch"] == epoch else "somebody stopped the axis"


def _to_rest(client: DaemonClient, method: str, asker: dict[str, str]) -> None:
    """Brake; a fault has done so already."""
    with contextlib.suppress(CallError):
        client.call(method, wait_s=END_S, **asker)


def _placed(files: list[Path], out: Path) -> list[Path]:
    """The files under the name that was wanted, as links where the file system allows it: the daemon keeps its own."""
    placed = []
    for number, file in enumerate(files):
        target = out if number == 0 else out.with_name(f"{out.stem}_{number}{out.suffix}")
        try:
            os.link(file, target)
        except OSError:  # another file system, or not our file
            shutil.copyfile(file, target)
        placed.append(target)
    return placed
