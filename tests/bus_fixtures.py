"""A simulated drive on a bus for tests of more than one directory: one process and one recorded run a session.

There is but one vcan0, so that there must be but one drive on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:  # imported where they are used: other tests need none of it
    from uml.whole_run import WholeRun

BUS_KINDS = ["loopback", pytest.param("vcan", marks=pytest.mark.vcan)]


@pytest.fixture(scope="session", params=BUS_KINDS)
def drive_bus(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A bus with `fffo-drive sim` on it, node 1, time made of SYNCs."""
    from buses import one_bus
    from uml.whole_run import drive_process

    name = one_bus(request.param)
    with drive_process(name, tmp_path_factory.mktemp("drive")):
        yield name


@pytest.fixture(scope="session")
def whole_run(drive_bus: str, tmp_path_factory: pytest.TempPathFactory) -> WholeRun:
    """Bring-up, 0.3 s of a profile, and the end."""
    from uml.whole_run import record

    return record(drive_bus, tmp_path_factory.mktemp("run"), 0.3)
