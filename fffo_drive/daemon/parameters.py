"""The methods of the API and their parameters as records: the server checks them, `schema` and `ctl --help` show them.

`ctl` imports this module and has to start quickly, so nothing of the loop is imported here.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import BaseModel, Field, model_validator

from ..config.profile_sections import ProfileSection
from ..documents import DocumentError, StrictRecord
from ..roles import Role

PROTOCOLS = (1,)  # supported versions of this API, the newest last

DEFAULT_PROFILE = "default"  # name of the axis file's own `profile:` section

LEAST_FOR_S = 0.01  # of a timed set point

Seconds = Annotated[float, Field(ge=0, le=600)]


class Nothing(StrictRecord):
    """No parameters."""


class Info(StrictRecord):
    """Parameters of `info`."""

    protocol: Annotated[
        int | Annotated[list[int], Field(min_length=1, max_length=100)] | None,
        Field(description="API version that the client supports, or a list; the newest that both support is used"),
    ] = None


class Commanded(StrictRecord):
    """Parameters of every request that does more than look."""

    who: Annotated[
        str | None,
        Field(max_length=80, pattern=r"^[\w .:()@-]*$", description="on whose behalf: a name and a role, for the log"),
    ] = None


class Bound(Commanded):
    """Parameters of requests for torque or motion."""

    epoch: Annotated[
        int | None, Field(ge=1, description="epoch that a status reported: refused if a new epoch has begun since")
    ] = None


class Enable(Bound):
    """Parameters of `enable`."""

    hold: Annotated[
        bool,
        Field(
            description="put this connection in charge: daemon.client_loss applies when it closes, or says nothing for "
            "daemon.client_silence_s (an empty line is enough)"
        ),
    ] = False
    wait_s: Annotated[Seconds, Field(description="how long to wait for Operation Enabled; 0: do not wait")] = 10.0


class Ending(Commanded):
    """Parameters of requests that end a motion or a fault."""

    wait_s: Annotated[Seconds, Field(description="how long to wait for completion; 0: do not wait")] = 10.0


class Motion(Bound):
    """Parameters of requests for motion: from the first stop on, they have to name the epoch."""


class Start(Motion):
    """Parameters of `start`."""

    profile: Annotated[
        str | ProfileSection,
        Field(
            description="name of a profile in the axis file (see `info`), or a profile's keys: {kind: sine, ...}",
            json_schema_extra={"cli": "profile"},
        ),
    ]
    wait_s: Annotated[Seconds, Field(description="how long to wait for its end; 0: do not wait")] = 0.0


Velocity = Annotated[float, Field(ge=-1000, le=1000)]


class Renewed(Motion):
    """Parameters of requests with a set point that lives on a lease: renewed within daemon.set_points.jog_timeout_s."""

    renews: Annotated[
        int | None,
        Field(ge=1, description="number of the set point to renew (`set_point` in its answer): refused if it is over"),
    ] = None


class Jog(Renewed):
    """Parameters of `jog`."""

    to_rps: Annotated[Velocity, Field(description="velocity; 0 ends the jog")]


class Leased(Renewed):
    """Parameters of set points that live on a lease, last for a time, or may run on."""

    for_s: Annotated[
        float | None,
        Field(ge=LEAST_FOR_S, le=600, description="duration; without it or run_on the set point has to be renewed"),
    ] = None
    run_on: Annotated[
        bool, Field(description="it may run on until the next set point or stop, also when its client is gone")
    ] = False
    wait_s: Annotated[
        Seconds, Field(description="how long to wait until the reference reaches it (for_s or run_on); 0: do not wait")
    ] = 0.0

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if sum((self.renews is not None, self.for_s is not None, self.run_on)) > 1:
            raise ValueError("give one of renews, for_s and run_on")
        if self.wait_s > 0 and self.leased:
            raise ValueError("wait_s needs for_s or run_on: what has to be renewed cannot be waited for")
        return self

    @property
    def leased(self) -> bool:
        """It has to be renewed."""
        return self.for_s is None and not self.run_on


class SetVelocity(Leased):
    """Parameters of `velocity`."""

    to_rps: Annotated[Velocity, Field(description="velocity; 0: standstill. Standstill follows for_s")]


class Step(Leased):
    """Parameters of `step`."""

    by_rps: Annotated[
        Velocity,
        Field(
            description="change of the present velocity set point; after for_s back to the one before if that may run "
            "on, else to standstill. With renews nothing is added again"
        ),
    ]


class Toggle(Commanded):
    """Parameters of `toggle`."""

    to: Annotated[
        Literal["ff", "fb", "off"], Field(description="friction from the reference, from the feedback, or off")
    ]


class Model(Commanded):
    """Parameters of `model`."""

    text: Annotated[
        str, Field(max_length=200_000, description="a model file (YAML)", json_schema_extra={"cli": "file"})
    ]
    name: Annotated[str, Field(max_length=255, description="its file name, for messages and recordings")] = "model.yaml"


class Set(Commanded):
    """Parameters of `set`."""

    key: Annotated[str, Field(description="dotted key of the axis file (see info: keys)")]
    value: Annotated[float | bool, Field(description="number, or true or false for a switch")]


class RecordSwitch(Commanded):
    """Parameters of `record`."""

    to: Annotated[Literal["on", "off"], Field(description="begin or end a recording")]


class Events(StrictRecord):
    """Parameters of `events`."""

    since: Annotated[int, Field(ge=0, description="number of the last event already known")] = 0
    limit: Annotated[int, Field(ge=1, le=1000, description="largest number of events; the newest are returned")] = 100


class Subscribe(StrictRecord):
    """Parameters of `subscribe`; it replaces an earlier subscription."""

    status_hz: Annotated[float, Field(ge=0, le=50, description="statuses per second; 0: none")] = 0.0
    events: Annotated[bool, Field(description="send every event as it happens")] = True


def agreed_protocol(spoken: int | list[int] | None) -> int:
    """The newest version of the API that client and daemon support; the daemon's newest if the client names none.

    Raises DocumentError if there is no common version.
    """
    theirs = PROTOCOLS if spoken is None else [spoken] if isinstance(spoken, int) else spoken
    both = [version for version in PROTOCOLS if version in theirs]
    if not both:
        ours, asked = (", ".join(map(str, versions)) for versions in (PROTOCOLS, theirs))
        raise DocumentError(
            f"protocol: this daemon speaks {ours} of its API, the client {asked}; use a client of its version"
        )
    return both[-1]


class Method(NamedTuple):
    """One method; `methods.Api` has its handler under the same name."""

    parameters: type[BaseModel]
    role: Role  # that a page or viewer needs for it
    summary: str

    @property
    def watching(self) -> bool:
        """It only looks: allowed on the read-only socket."""
        return self.role == "look"


METHODS: dict[str, Method] = {
    "info": Method(Info, "look", "protocol version, axis, drive, profiles, keys, states"),
    "status": Method(Nothing, "look", "the present status"),
    "enable": Method(Enable, "move", "torque on; the axis is held at standstill"),
    "disable": Method(Ending, "stop", "brake to standstill, then no torque"),
    "start": Method(Start, "move", "run a profile"),
    "jog": Method(Jog, "move", "turn at a velocity for as long as the jog is renewed (ctl renews it until Ctrl-C)"),
    "velocity": Method(SetVelocity, "move", "turn at a velocity: while it is renewed, for a time, or until changed"),
    "step": Method(Step, "move", "change the velocity set point by an amount; it lives as a velocity does"),
    "toggle": Method(Toggle, "tune", "friction from the reference, from the feedback, or off"),
    "stop": Method(Ending, "stop", "brake to standstill and stay enabled"),
    "quick_stop": Method(Ending, "stop", "the drive's quick stop, then no torque"),
    "reset_fault": Method(Ending, "move", "leave a latched fault"),
    "model": Method(Model, "tune", "use another model file; only without torque"),
    "set": Method(Set, "tune", "change one gain or switch until the next reload"),
    "reload": Method(Commanded, "tune", "read the axis file again, as SIGHUP does"),
    "record": Method(RecordSwitch, "move", "begin or end a recording"),
    "events": Method(Events, "look", "the latest events"),
    "subscribe": Method(Subscribe, "look", "receive statuses at a rate, and events, on this connection"),
    "schema": Method(Nothing, "look", "JSON schemas of all parameters"),
}
