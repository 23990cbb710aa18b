"""From a bus with a drive on it to an axis file: listen, scan, read, list obstacles, measure, write.

Nothing moves: the drive is never enabled here. `Talk` asks the user what no drive knows.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ..can import frame as can
from ..can.bpf import CanFilter
from ..can.lease import BusHeldError, BusLease
from ..can.link import Link, LinkError, open_link
from ..config.axis import AxisFile
from ..config.checks import bus_sum
from ..documents import DocumentError
from ..drive.canopen.config import LISTEN_S, ONE_MASTER
from ..drive.canopen.drive import CanopenDrive
from ..drive.canopen.listening import Heard, Listening
from ..drive.canopen.lss import LssAddress, LssLink, LssMaster
from ..drive.canopen.scan import NodeName, Roll, Sign, ask_every_node, name_node, open_service
from ..drive.canopen.sdo_objects import SdoObjects
from ..drive.canopen.service import Emergency, service_filters
from ..drive.port import BusOccupiedError, BusUnavailableError, DriveRefusedError
from ..model.parameters import ModelFile
from ..runtime.fault_at_start import clear_fault
from ..runtime.session import Session
from ..system.bus import interface_bitrate_hz
from ..system.findings import HostFinding, Severity, failure, ok, warning
from ..system.host import Host
from .axis_draft import Draft, Place, inertia_kg_m2, make_draft, model_file_of
from .drive_facts import OPTIONS, Answers, Fact, SourcedFacts, drive_facts, named_profile
from .load_range import ask_range
from .rate_trial import (
    RATES_HZ,
    Choice,
    RateTrial,
    RoundTrip,
    choose_rate,
    objections,
    problems_at,
    round_trip,
    try_rate,
    turnaround_of_drive_us,
)
from .readiness import stands_between, velocity_step

FEEDBACK_GAP_FACTOR = 3  # of the longest gap that was seen, on a loopback bus
LEAST_PATIENCE_TICKS, MOST_PATIENCE_TICKS = 200, 10_000
BOOT_S = 2.0  # for a node that was given an id
LOOPBACK = "loopback:"
LOADS = "loads"  # a question that follows all others


class Talk(Protocol):
    """The user: gets messages and progress, and answers what no drive knows."""

    def tell(self, text: str) -> None:
        """A message: a step that begins, or a result."""
        ...

    def progress(self, share: float) -> None:
        """Progress of the last step, 0 to 1."""
        ...

    def ask(self, question: str, proposal: str) -> str | None:
        """The answer; the proposal if nothing was typed; None if nobody can answer."""
        ...


class Wishes(NamedTuple):
    """Options of a bring-up."""

    bus: str
    out: Path = Path("axis.yaml")
    node_id: int | None = None
    assign_id: int | None = None
    answers: Answers = Answers()
    profile: str | None = None  # of the drive's family; None: by the drive's identity
    bitrate_hz: int | None = None
    force: bool = False
    measure: bool = True
    seconds: float = 2.0  # at each rate
    reset_fault: bool = False  # of a drive that is in fault, by the loop of the measurement


class BringUpReport(NamedTuple):
    """Result of a bring-up."""

    bus: str
    verdict: str
    ready: bool  # a file was written, and nothing prevents commissioning
    nodes: tuple[NodeName, ...] = ()
    without_id: tuple[LssAddress, ...] = ()
    node_id: int | None = None
    findings: tuple[HostFinding, ...] = ()
    objects: dict[str, int] = {}  # noqa: RUF012  # of a NamedTuple: nobody changes it
    unreadable: dict[str, str] = {}  # noqa: RUF012
    facts: dict[str, Fact] = {}  # noqa: RUF012
    profile: str | None = None  # of the drive's family
    notes: tuple[str, ...] = ()  # of the profile
    missing: tuple[str, ...] = ()  # options that would supply the unknown values
    adapter: RoundTrip | None = None
    trials: tuple[RateTrial, ...] = ()
    choice: Choice | None = None
    axis_file: Path | None = None
    model_file: Path | None = None
    next_command: str = ""

    def as_json(self) -> dict[str, Any]:
        """Names and numbers alone."""
        return {
            **self._asdict(),
            "nodes": [{**one._asdict(), "vendor": one.vendor, "drive": one.is_drive} for one in self.nodes],
            "without_id": [one._asdict() for one in self.without_id],
            "findings": [one._asdict() for one in self.findings],
            "facts": {name: fact._asdict() for name, fact in self.facts.items()},
            "adapter": None if self.adapter is None else {k: v._asdict() for k, v in self.adapter._asdict().items()},
            "trials": [_trial_json(one) for one in self.trials],
            "choice": None if self.choice is None else self.choice._asdict(),
            "axis_file": None if self.axis_file is None else str(self.axis_file),
            "model_file": None if self.model_file is None else str(self.model_file),
        }


def _trial_json(trial: RateTrial) -> dict[str, Any]:
    return {key: value._asdict() if hasattr(value, "_asdict") else value for key, value in trial._asdict().items()}


def bring_up_axis(wishes: Wishes, talk: Talk) -> BringUpReport:
    """Bring an axis up, as far as possible.

    Raises BusUnavailableError (BusOccupiedError before anything was sent), DriveRefusedError (LSS), DocumentError for
    files that are there already.
    """
    refuse_overwriting(wishes)
    if wishes.profile is not None:
        named_profile(wishes.profile)  # an unknown one is refused before a bus is used
    with _alone_on(wishes.bus, talk) as heard:
        signs, nodes = _scan(wishes.bus, talk, heard.nodes)
        without_id = _search_without_id(wishes.bus, talk)
        if without_id and (assigned := _assign(wishes, without_id, signs, talk)) is not None:
            (signs, nodes), without_id = _scan(wishes.bus, talk), ()
            wishes = wishes._replace(node_id=wishes.node_id or assigned)
        found = BringUpReport(wishes.bus, "", False, nodes, without_id)
        chosen = _choose(wishes, nodes, talk)
        if isinstance(chosen, str):
            if without_id:
                chosen = f"{len(without_id)} without a node id: give one with --assign ID; {chosen}"
            return found._replace(verdict=chosen)
        found = found._replace(node_id=chosen.node_id)
        objects, facts, emergencies = _read(wishes, chosen, talk)
        emergencies = [*next(sign.emergencies for sign in signs if sign.node_id == chosen.node_id), *emergencies]
        adapter = round_trip(wishes.bus, chosen.node_id) if wishes.measure else None
    return _propose(wishes, found._replace(adapter=adapter), chosen, objects, facts, emergencies, talk)


def refuse_overwriting(wishes: Wishes) -> None:
    """Raise DocumentError if a file exists already, before a bus is used."""
    there = [str(path) for path in (wishes.out, model_file_of(wishes.out)) if path.exists()]
    if there and not wishes.force:
        raise DocumentError(f"{' and '.join(there)}: exists already; give another --out, or overwrite with --force")
    if not wishes.out.parent.is_dir():
        raise DocumentError(f"{wishes.out}: no such directory: {wishes.out.parent}")


@contextmanager
def _alone_on(bus: str, talk: Talk) -> Iterator[Heard]:
    """Holds the lease of the bus, after listening for other masters. Raises BusOccupiedError."""
    talk.tell(f"listening on {bus} for other masters; nothing is sent yet")
    try:
        lease = BusLease(bus)
    except BusHeldError as error:
        raise BusOccupiedError(f"{error}: {ONE_MASTER}") from error
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error
    try:
        heard = _heard(bus)
        if obstacles := heard.obstacles():
            found = "; ".join(f"{obstacle.text}: {obstacle.remedy}" for obstacle in obstacles)
            raise BusOccupiedError(f"{bus}: {found}")
        yield heard
    finally:
        lease.close()


def _heard(bus: str) -> Heard:
    try:
        listening = Listening(bus, LISTEN_S)
        try:
            return listening.heard()
        finally:
            listening.close()
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error


def _scan(bus: str, talk: Talk, heard: Iterable[int] = ()) -> tuple[list[Sign], tuple[NodeName, ...]]:
    """Names of all nodes. `heard`: nodes whose heartbeat was heard before."""
    talk.tell("asking node ids 1 to 127 for their type")
    roll = Roll(heard)
    kinds = (can.SDO_RESPONSE, can.HEARTBEAT, can.EMERGENCY)
    filters = [CanFilter(kind, can.STANDARD_MASK & ~0x7F) for kind in kinds]
    try:
        with open_link(bus, filters=filters) as link:
            count = len(can.NODE_IDS)
            ask_every_node(link, roll, progress=lambda node: talk.progress(node / count))
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error
    nodes = tuple(name_node(sign, lambda node: _service_link(bus, node)) for sign in roll.signs)
    for node in nodes:
        talk.tell(f"  {node.text}")
    return roll.signs, nodes


def _service_link(bus: str, node_id: int) -> Link:
    try:
        return open_link(bus, filters=service_filters(node_id))
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error


def _search_without_id(bus: str, talk: Talk) -> tuple[LssAddress, ...]:
    talk.tell("asking for nodes without an id (LSS fastscan)")
    with _lss(bus, talk) as master:
        found = tuple(master.nodes_without_id())
    for address in found:
        talk.tell(f"  without a node id: {address.text}")
    return found


@contextmanager
def _lss(bus: str, talk: Talk) -> Iterator[LssMaster]:
    try:
        link = LssLink(bus)
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error
    try:
        yield LssMaster(link.ask, talk.progress)
    finally:
        link.close()


def _assign(wishes: Wishes, without_id: Sequence[LssAddress], signs: list[Sign], talk: Talk) -> int | None:
    """Give the node without id the one from the options or the user; None without either."""
    taken = [sign.node_id for sign in signs]
    node_id = wishes.assign_id
    if len(without_id) > 1:
        if node_id is not None:
            raise DriveRefusedError(f"--assign {node_id}: {len(without_id)} nodes have no id; connect one at a time")
        return None
    if node_id is None:
        free = next(node for node in can.NODE_IDS if node not in taken)
        answer = talk.ask(f"which id for the node without one (1 to 127; no: none)? {free} is free", "no")
        if answer is None or not answer.isdecimal():
            return None
        node_id = int(answer)
    if node_id in taken:
        raise DriveRefusedError(f"node id {node_id} is taken on {wishes.bus}; choose another")
    boot_up = [CanFilter(can.HEARTBEAT + node_id)]
    with _lss(wishes.bus, talk) as master, open_link(wishes.bus, filters=boot_up) as link:
        stored = master.assign(without_id[0], node_id)
        link.receive(BOOT_S)  # a scan follows
    kept = "it is stored" if stored else "it is lost when the drive is switched off: store it with the vendor's tool"
    talk.tell(f"  node id {node_id} given to the node with {without_id[0].text}; {kept}")
    return node_id


def _choose(wishes: Wishes, nodes: Sequence[NodeName], talk: Talk) -> NodeName | str:
    """The node to bring up, or the reason why there is none."""
    if wishes.node_id is not None:
        chosen = next((node for node in nodes if node.node_id == wishes.node_id), None)
        if chosen is None:
            others = ", ".join(f"node {node.node_id}" for node in nodes) or "no other node"
            return f"node {wishes.node_id} does not answer on {wishes.bus}; {others} does"
    else:
        usable = [node for node in nodes if node.is_drive and not node.remark] or [n for n in nodes if not n.remark]
        if not usable:
            said = "; ".join(node.text for node in nodes)
            return said or f"no node answers on {wishes.bus}: {_where_to_look(wishes.bus)}"
        chosen = usable[0]
        if len(usable) > 1:
            ids = ", ".join(str(node.node_id) for node in usable)
            answer = talk.ask(f"which node is the drive of the axis ({ids})?", str(chosen.node_id))
            named = next((node for node in usable if str(node.node_id) == answer), None)
            if named is None:
                return f"{len(usable)} nodes answer ({ids}): choose one with --node"
            chosen = named
    return f"node {chosen.node_id}: {chosen.remark}" if chosen.remark else chosen


def _where_to_look(bus: str) -> str:
    if bus.startswith(LOOPBACK):
        return f"start a drive there, `fffo-drive sim configs/simulated_drive.yaml --bus {bus}`"
    return (
        "check power, wiring, termination (60 ohm between CAN_H and CAN_L) and bit rate; a stopped node without "
        "heartbeat is not found: switch the drive off and on"
    )


def _read(wishes: Wishes, node: NodeName, talk: Talk) -> tuple[SdoObjects, SourcedFacts, list[Emergency]]:
    talk.tell(f"reading the objects of node {node.node_id}")
    service = open_service(_service_link(wishes.bus, node.node_id), node.node_id)
    try:
        objects = SdoObjects(service.read)
        objects.read_all(talk.progress)
        facts = _facts(objects, wishes, node, talk)
        objects.stop_reading()
        return objects, facts, list(service.emergencies)
    finally:
        service.close()


def _propose(
    wishes: Wishes, found: BringUpReport, node: NodeName, objects: SdoObjects, facts: SourcedFacts,
    emergencies: Sequence[Emergency], talk: Talk,
) -> BringUpReport:  # fmt: skip
    """Trials, findings, files."""

    def obstacles(operational: bool) -> list[HostFinding]:
        return stands_between(objects, emergencies, operational, facts.written, _reset_command(wishes, node))

    found = found._replace(
        objects=objects.values, unreadable=dict(objects.unreadable), facts={**facts.scales, **facts.section},
        profile=facts.profile, notes=facts.profile_remarks,
    )  # fmt: skip
    if facts.unusable:
        findings = [*_of_facts(facts), *obstacles(False)]
        text = f"CANNOT BE USED: {_who(node)} lacks what this program needs; no axis file was written"
        return found._replace(verdict=text, findings=_in_order(findings))
    if facts.missing:
        findings = [*_of_facts(facts), *obstacles(False)]
        asked = "; ".join(f"{OPTIONS[name][0]} ({OPTIONS[name][1]})" for name in facts.missing)
        findings.insert(0, failure("unknown", f"the drive does not report: {asked}", "give them with these options"))
        options = tuple(OPTIONS[name][0] for name in facts.missing)
        text = _verdict(node, findings, None, "no axis file was written")
        return found._replace(verdict=text, findings=_in_order(findings), missing=options)
    place = _place(wishes, found, node, facts)
    try:
        draft = make_draft(place, facts, objects)
    except DocumentError as error:
        findings = [
            failure("values", text, "the drive reports an impossible value: give the right one with an option")
            for text in str(error).splitlines()
        ]
        findings += [*_of_facts(facts), *obstacles(False)]
        text = _verdict(node, findings, None, "no axis file was written")
        return found._replace(verdict=text, findings=_in_order(findings))
    trials: list[RateTrial] = []
    operational, cleared = False, ""
    if wishes.measure and not facts.needs:  # what it lacks would be refused
        trials, later, cleared = _try_rates(wishes, draft, objects, talk)
        emergencies = later if cleared else [*emergencies, *later]
        operational = any(not trial.refused for trial in trials)
    turnaround_us = turnaround_of_drive_us(trials, found.adapter, draft.axis)
    choice = (
        choose_rate(
            trials, draft.axis.loop, lambda rate_hz: problems_at(draft.axis, draft.model, rate_hz, turnaround_us)
        )
        if trials
        else None
    )
    findings = [*_of_facts(facts), *obstacles(operational)]
    findings += [warning("fault", cleared, "look up its code in the vendor's manual")] if cleared else []
    findings += velocity_step(
        facts.scales["velocity_units_per_rps"].value, draft.axis.controller.observer.feedback_band_rps
    )
    draft = make_draft(_measured(place, trials, choice, turnaround_us), facts, objects)
    findings += _of_trials(trials, choice, draft.axis, draft.model)
    model_file = model_file_of(wishes.out)
    wishes.out.write_text(draft.axis_text, encoding="utf-8")
    model_file.write_text(draft.model_text, encoding="utf-8")
    ready = not any(one.level is Severity.FAILURE for one in findings)
    return found._replace(
        verdict=_verdict(node, findings, choice, f"{wishes.out} was written"),
        ready=ready, objects=objects.values, unreadable=dict(objects.unreadable), findings=_in_order(findings),
        trials=tuple(trials), choice=choice, axis_file=wishes.out, model_file=model_file,
        next_command=f"fffo-drive commission {shlex.quote(str(wishes.out))}",
    )  # fmt: skip


def _reset_command(wishes: Wishes, node: NodeName) -> str:
    """The same bring-up, which clears a fault first. What it has written now it overwrites then."""
    words = ["fffo-drive", "bring-up", wishes.bus, "--node", str(node.node_id), "--out", str(wishes.out)]
    return shlex.join([*words, "--force", "--reset-fault"])


def _in_order(findings: Sequence[HostFinding]) -> tuple[HostFinding, ...]:
    """Failures first."""
    return tuple(sorted(findings, key=lambda one: (one.level is not Severity.FAILURE, one.level is Severity.OK)))


def _of_facts(facts: SourcedFacts) -> list[HostFinding]:
    """What the drive lacks, its replacements, and remarks on its units and axes."""
    found = [failure("lacks", str(need), "`fffo-drive config schema axis` lists the keys") for need in facts.needs]
    found += [warning("replacement", text, "written to the axis file") for text in facts.stand_ins]
    found += [warning("remark", text, "") for text in facts.remarks if not text.startswith("0x6076")]
    found += [ok("silence", f"when the PC is silent: {facts.silence}")] * (not facts.needs)
    return found


def _facts(objects: SdoObjects, wishes: Wishes, node: NodeName, talk: Talk) -> SourcedFacts:
    """Facts from the drive, completed by the user's answers; the user can correct assumptions."""
    answers, asked = wishes.answers, set[str]()
    while True:
        facts = drive_facts(objects, answers, node.node_id, node.vendor_id, node.product_code, wishes.profile)
        if facts.unusable:
            return facts
        scales = facts.scales
        wanted = [*facts.missing, *(name for name in OPTIONS if name in scales and scales[name].assumed)]
        name = next((one for one in wanted if one not in asked), None)
        if name is None and "inertia_range_kg_m2" not in scales and LOADS not in asked and not facts.missing:
            asked.add(LOADS)
            answers = answers._replace(inertia_range_kg_m2=_loads(facts, talk))
            continue
        if name is None:
            return facts
        asked.add(name)
        proposal = f"{scales[name].value:g}" if name in scales else ""
        why = f" ({scales[name].source})" if name in scales else ""
        answer = talk.ask(f"{OPTIONS[name][1]}?{why}", proposal)
        value = _number(answer)
        if value is not None and answer != proposal:
            answers = Answers(**{**answers._asdict(), name: round(value) if name == "counts_per_rev" else value})


def _loads(facts: SourcedFacts, talk: Talk) -> tuple[float, float] | None:
    """The range of inertia, asked for until the answer is one, or no."""
    while True:
        try:
            return ask_range(f"{inertia_kg_m2(facts).value:.4g} kg m2", talk.ask)
        except DocumentError as error:
            talk.tell(str(error))


def _number(text: str | None) -> float | None:
    """A number above 0; None for anything else."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if 0.0 < value < float("inf") else None


def _place(wishes: Wishes, found: BringUpReport, node: NodeName, facts: SourcedFacts) -> Place:
    name = re.sub(r"[^\w.-]", "_", wishes.out.stem)
    shown = "".join(
        letter
        for letter in f"{node.device_name or 'a drive'}{f', {node.vendor}' if node.vendor_id else ''}"
        if letter.isprintable()
    )
    found_hz = interface_bitrate_hz(Host(), wishes.bus)
    bitrate = Fact(1_000_000, "assumed" if not wishes.bus.startswith(LOOPBACK) else "a loopback bus has none")
    if found_hz is not None:
        bitrate = Fact(found_hz, "read: of the interface")
    if wishes.bitrate_hz is not None:
        bitrate = Fact(wishes.bitrate_hz, "given (--bitrate)")
    others = tuple(one.node_id for one in found.nodes if one.node_id != node.node_id)
    highest_hz = min(RATES_HZ[-1], facts.profile_keys.get("highest_rate_hz") or RATES_HZ[-1])
    rate = Fact(max(rate for rate in RATES_HZ if rate <= highest_hz), "assumed: not measured yet")
    return Place(name, model_file_of(wishes.out).name, wishes.bus, bitrate, node.node_id, shown, others, rate)


def _try_rates(
    wishes: Wishes, draft: Draft, objects: SdoObjects, talk: Talk
) -> tuple[list[RateTrial], list[Emergency], str]:
    """Trials from the lowest rate up until one is impossible, EMCY meanwhile, and a fault that was cleared."""
    emergencies: list[Emergency] = []
    cleared: list[str] = []

    def prepare(session: Session) -> None:
        if not wishes.reset_fault:
            return
        try:
            text = clear_fault(session, True, "")
        except DriveRefusedError as error:  # it is among the findings
            text = ""
            talk.tell(f"  {error}")
        if text:
            talk.tell(f"  {text}")
            cleared.append(text)

    def look(drive: CanopenDrive) -> None:
        objects.read_again(drive.read_object)  # what changes, while the drive is operational
        emergencies.extend(() if cleared else drive.emergencies)

    talk.tell("measuring without torque: SYNC and feedback, the drive stays disabled")
    talk.tell("  (the first time, the loop is compiled, which takes a minute or two)")
    trials: list[RateTrial] = []
    for rate_hz in RATES_HZ:
        trial = try_rate(draft.axis, draft.model, rate_hz, wishes.seconds, look, prepare=prepare)
        trials.append(trial)
        if trial.refused:
            talk.tell(f"  {rate_hz} Hz: not possible: {trial.refused}")
            break
        talk.tell(
            f"  {rate_hz} Hz: feedback after {trial.turnaround_us.median:.0f} us (99 % "
            f"{trial.turnaround_us.most:.0f}), "
            f"{trial.missing} of {trial.ticks} missing, {trial.late + trial.skipped} late"
        )
    return trials, emergencies, "; ".join(cleared)


def _of_trials(
    trials: Sequence[RateTrial], choice: Choice | None, axis: AxisFile, model: ModelFile
) -> list[HostFinding]:
    """Obstacles and warnings from the trials. `axis`: with the rate that is written."""
    if not trials or choice is None:
        return []
    found = [warning("real time", refusal, "`fffo-drive doctor` gives the commands") for refusal in trials[0].refusals]
    if trials[0].refused:
        return [*found, failure("bring-up", trials[0].refused, "remove the cause, then bring up again")]
    if choice.rate_hz is None:
        remedy = "the axis file has the lowest rate; expect late ticks, and see `fffo-drive doctor`"
        return [*found, warning("rate", choice.reason, remedy)]
    disturbed = [trial for trial in trials if trial.rate_hz < choice.rate_hz and objections(trial, axis.loop)]
    found += [
        warning(
            "machine", f"at {trial.rate_hz} Hz: {'; '.join(objections(trial, axis.loop))}",
            "a brief disturbance: measure for longer (--seconds 60), and see `fffo-drive doctor`",
        )
        for trial in disturbed
    ]  # fmt: skip
    _, chain = bus_sum(axis, model)
    if not chain.fits:
        text = (
            f"at {choice.rate_hz} Hz the worst case on the bus is {-chain.slack_s * 1e6:.0f} us beyond the period: a "
            "command that arrives after the next SYNC acts one period later"
        )
        found.append(warning("bus", text, "`fffo-drive config check` prints the sum; lower loop.rate_hz"))
    return found


def _measured(place: Place, trials: Sequence[RateTrial], choice: Choice | None, turnaround_us: float | None) -> Place:
    """The place with the results of the trials."""
    tried = [trial for trial in trials if not trial.refused]
    if not tried or choice is None:
        return place
    if choice.rate_hz is None:
        rate = Fact(tried[0].rate_hz, "the lowest that was tried: none fits on this machine")
    else:
        rate = Fact(choice.rate_hz, "measured: the highest that fits")
    gap = max(trial.longest_gap for trial in tried)
    loopback = place.bus.startswith(LOOPBACK)
    return place._replace(
        rate_hz=rate,
        turnaround_us=None if turnaround_us is None else Fact(float(f"{turnaround_us:.3g}"), "measured"),
        realtime_refused=bool(tried[0].refusals),
        patience_ticks=min(MOST_PATIENCE_TICKS, max(LEAST_PATIENCE_TICKS, FEEDBACK_GAP_FACTOR * gap))
        if loopback
        else 0,
    )


def _who(node: NodeName) -> str:
    return f"node {node.node_id} ({node.device_name or 'without a name'})"


def _verdict(node: NodeName, findings: Sequence[HostFinding], choice: Choice | None, files: str) -> str:
    in_the_way = sum(one.level is Severity.FAILURE for one in findings)
    who = _who(node)
    rate = f" at {choice.rate_hz} Hz" if choice is not None and choice.rate_hz is not None else ""
    if in_the_way:
        problems = "1 problem" if in_the_way == 1 else f"{in_the_way} problems"
        return f"NOT READY: {problems} at {who}; {files}"
    return f"READY to be commissioned{rate}: {who}; {files}"
