"""Cycle of the compiled loop against the same loop in C: receive, compute, send, row, housekeeping."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from cycle_port import (
    CLOCK_NS,
    CYCLE,
    MARK_NS,
    STATUS_EVERY,
    CyclePort,
    Ends,
    cycle_port,
    drive_config,
    loopback_bus,
    socket_pair,
)
from in_c import Declarations, compile_c, compiler_version, packed
from numba import typeof

from fffo_drive.can import frame
from fffo_drive.config.sections import AdaptationSection, NotchSection, RestSection, VelocitySection
from fffo_drive.control import adaptation, envelope, friction_observer, position_hold, reference, velocity_estimator
from fffo_drive.control.adaptation import AdaptationState, Adapted
from fffo_drive.control.controller import CONTROLLER_BLOCK_SIZE, CONTROLLER_NAMES, ControllerConfig, ControllerState
from fffo_drive.control.envelope import EnvelopeInputs, EnvelopeState
from fffo_drive.control.velocity_estimator import Measured, VelocityEstimatorState, VelocityEstimatorTerms
from fffo_drive.drive import cia402
from fffo_drive.drive.canopen import cyclic, object_map, port_memory, receiving, service_queue
from fffo_drive.drive.port import FEEDBACK, port_now_ns
from fffo_drive.model import friction
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime import tick
from fffo_drive.runtime.loop import run_loop
from fffo_drive.runtime.ring import new_ring
from fffo_drive.runtime.tick import Baseline, LawOutput, LoopConfig, ProfileCursor, Timing
from fffo_drive.signals import ROW
from fffo_drive.workflows.plan import Plan, make_plan, plan_session

NAME = "loop_cycle"
AXIS = ROOT / "configs" / "axis_canopen.yaml"
TARGET, LATE_TARGET = 1.05, 1.10  # of the median cycle and of the 99th percentile
REVERSING_HZ = 20.0
AHEAD_NS = 1_000_000_000  # the first deadline lies far ahead, so that no cycle is late and none is skipped
CLOCK_FIELDS = ("deadline_ns", "lateness_ns", "turnaround_ns", "busy_ns", "heartbeat_age_ns", "late")
CONSTANTS: tuple[tuple[ModuleType, tuple[str, ...]], ...] = (
    (b, ()),
    (port_memory, ()),
    (frame, ()),
    (cia402, ("STATE_", "CONTROL_", "GOAL_", "STATUS_", "NOT_READY_")),
    (envelope, ("LIMIT_", "TRIP_", "REACTION_", "STATUS_", "UNHEEDED_", "PAUSE_")),
    (object_map, ("FIELD_",)),
    (service_queue, ("SLOTS", "HEAD", "TAIL", "CYCLE_NS", "MAX_AGE_NS", "SENT_ASIDE", "LOOP_REQUESTS")),
    (receiving, ("SECOND_",)),
    (cyclic, ("BESIDE_RPDO", "WITHDRAWAL_EVERY", "SILENT_TICKS", "LOST_TICKS")),
    (friction, ("OMEGA_", "STRIBECK_FLOOR", "PRESLIDING_OVER")),
    (friction_observer, ("TOGGLE_",)),
    (reference, ("MODE_",)),
    (velocity_estimator, ("COMMANDS", "BRIDGED_TICKS")),
    (position_hold, ("SETTLED",)),
    (adaptation, ("EXCITED_SHARE", "FOLLOWS_IN", "OFFSET_AT", "COULOMB_AT", "VISCOUS_AT")),
    (tick, ("FLAG_",)),
)

Rows = np.ndarray[Any, np.dtype[np.void]]


class Memory(NamedTuple):
    """What one run of the loop works on; the arguments of `run_loop`, and what keeps its sockets open."""

    port: CyclePort
    blocks: b.Blocks
    scratch: np.ndarray[Any, np.dtype[np.float64]]
    ring: Any
    ends: Ends


class CycleRun(NamedTuple):
    """What a run left behind."""

    cycles_ns: np.ndarray[Any, np.dtype[np.int64]]
    rows: Rows


class Cycles:
    """The loop in both languages, on any pair of sockets."""

    def __init__(self, plan: Plan, toggle: int = friction_observer.TOGGLE_FEEDFORWARD) -> None:
        self._plan = plan
        self._toggle = toggle
        self._session = plan_session(plan)
        memory = self._memory(socket_pair, 1, paced=False)
        self._in_c = compile_c("loop.c", _declarations(memory, self._session.loop, self._session.envelope))
        self._in_c.run_loop.restype = ctypes.c_int64
        self._compile(memory)
        memory.ends.close()

    @property
    def loop(self) -> LoopConfig:
        """Times of the loop."""
        return self._session.loop

    def _memory(self, bus: Callable[[], Ends], cycles: int, paced: bool) -> Memory:
        ends = bus()
        port = cycle_port(drive_config(self._plan), ends, self._plan.profile, cycles, paced)
        blocks = b.new_blocks(self._session.controller, self._plan.profile.values.size)
        blocks.control[b.TOGGLE] = self._toggle
        blocks.control[b.GOAL] = cia402.GOAL_ENABLED
        b.publish_profile(blocks, self._plan.profile)
        return Memory(port, blocks, np.zeros((2, CONTROLLER_BLOCK_SIZE)), new_ring(cycles), ends)

    def _compile(self, memory: Memory) -> None:
        arguments = (memory.port, self._session.loop, self._session.envelope, *memory[1:4], 0)
        run_loop.compile(tuple(typeof(argument) for argument in arguments))  # type: ignore[attr-defined]

    def run(
        self, language: str, bus: Callable[[], Ends], cycles: int, paced: bool = False, ahead_ns: int = AHEAD_NS
    ) -> CycleRun:
        """One run of `cycles` cycles by the kernels or by C ("numba", "C"), in the calling thread."""
        memory = self._memory(bus, cycles, paced)
        loop = self._session.loop._replace(max_ticks=cycles)
        try:
            first_ns = port_now_ns(memory.port) + ahead_ns
            if language == "C":
                self._run_c(memory, loop, first_ns)
            else:
                run_loop(memory.port, loop, self._session.envelope, *memory[1:4], first_ns)
        finally:
            memory.ends.close()
        return CycleRun(memory.port.cycles_ns[: cycles - 1], memory.ring.rows[:cycles])

    def _run_c(self, memory: Memory, loop: Any, first_ns: int) -> None:
        records = (memory.port, loop, self._session.envelope, memory.blocks)
        buffers = [ctypes.create_string_buffer(packed(record)) for record in records]
        scratch = ctypes.c_void_p(memory.scratch.ctypes.data)
        ring = ctypes.create_string_buffer(packed(memory.ring))
        self._in_c.run_loop(*buffers, scratch, ring, ctypes.c_int64(first_ns))


def _declarations(memory: Memory, loop: Any, envelope_config: Any) -> str:
    made = Declarations()
    for module, beginnings in CONSTANTS:
        made.constants(module, *beginnings)
    made.numbers({"STATUS_EVERY": STATUS_EVERY, "CYCLE": CYCLE, "MARK_NS": MARK_NS, "CLOCK_NS": CLOCK_NS})
    made.dtype("row", ROW)
    made.dtype("feedback", FEEDBACK)
    for record in (memory.port, loop, envelope_config, memory.blocks, memory.ring):
        made.record(record)
    for kind in (
        ControllerConfig, ControllerState, EnvelopeState, EnvelopeInputs, Timing, ProfileCursor, Baseline, LawOutput,
        VelocityEstimatorState, VelocityEstimatorTerms, Measured, AdaptationState, Adapted,
    ):  # fmt: skip
        made.record(zeros(kind))
    made.unpacking("unpack_controller", zeros(ControllerConfig), CONTROLLER_NAMES)
    return made.text


def with_estimate(plan: Plan) -> Plan:
    """The same plan on the estimated velocity."""
    controller = plan.axis.controller.model_copy(update={"velocity": VelocitySection(source="estimated")})
    return plan._replace(axis=plan.axis.model_copy(update={"controller": controller}))


def with_adaptation(plan: Plan) -> Plan:
    """The same plan with friction that is learned in service, as fast as it may be, on a sine that reverses at once."""
    observer = plan.axis.controller.observer.model_copy(update={"learns_in": "integral"})
    changed = {"observer": observer, "adaptation": AdaptationSection(enabled=True, time_s=5.0)}
    controller = plan.axis.controller.model_copy(update=changed)
    loop = plan.axis.loop
    profile = reference.sine("reversing", reference.MODE_VELOCITY, 10.0, loop.period_s, 5.0, REVERSING_HZ)
    return plan._replace(axis=plan.axis.model_copy(update={"controller": controller}), profile=profile)


def with_hold(plan: Plan) -> Plan:
    """The same plan with a position hold in short rests between two motions."""
    at_rest = RestSection(gain_share=0.5, release_friction=True, time_s=0.005, hold_a_per_rev_s=2000.0)
    controller = plan.axis.controller.model_copy(update={"at_rest": at_rest})
    times_s = np.array([0.0, 0.05, 0.1, 0.3])
    profile = reference.piecewise_linear(
        "stop and go", reference.MODE_VELOCITY, plan.axis.loop.period_s, times_s, np.array([0.0, 2.0, 0.0, 0.0])
    )
    profile = profile._replace(values=np.tile(profile.values, 10), derivatives=np.tile(profile.derivatives, 10))
    return plan._replace(axis=plan.axis.model_copy(update={"controller": controller}), profile=profile)


def with_notches(plan: Plan) -> Plan:
    """The same plan with two notches."""
    notches = [NotchSection(frequency_hz=110.0), NotchSection(frequency_hz=240.0, width=0.5, depth=0.0)]
    controller = plan.axis.controller.model_copy(update={"notches": notches})
    return plan._replace(axis=plan.axis.model_copy(update={"controller": controller}))


def zeros(kind: type) -> Any:
    """A NamedTuple of numbers and of such NamedTuples, all zero."""
    types = get_type_hints(kind).values()
    return kind(*(zeros(inner) if issubclass(inner, tuple) else inner() for inner in types))


def differing_fields(one: Rows, other: Rows) -> list[str]:
    """Fields of rows that are not the same number in both, those of the clock aside."""
    names = [name for name in ROW.names or () if name not in CLOCK_FIELDS]
    return [name for name in names if not np.array_equal(one[name], other[name], equal_nan=ROW[name].kind == "f")]


def figures_of(run: CycleRun) -> Figures:
    """Median, 99th percentile and smallest cycle, in nanoseconds."""
    median, late = np.quantile(run.cycles_ns, [0.5, 0.99])
    return {"median": float(median), "p99": float(late), "least": float(run.cycles_ns.min())}


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 40, 6)
    options.add_argument("--cycles", type=int, help="cycles in a pass and variant (default 4000; 1000 with --sample)")
    chosen = options.parse_args()
    cycles = chosen.cycles or (1000 if chosen.sample else 4000)
    report = Report(
        NAME, "One cycle of the loop (receive, compute, send, row, housekeeping), compiled by numba and by gcc -O2."
    )
    plan = make_plan(AXIS)
    loop, estimating, adapting = Cycles(plan), Cycles(with_estimate(plan)), Cycles(with_adaptation(plan))
    holding, notched = Cycles(with_hold(plan)), Cycles(with_notches(plan))
    buses = {
        "socket pair": (loop, socket_pair),
        "loopback bus": (loop, loopback_bus),
        "socket pair, estimated velocity": (estimating, socket_pair),
        "socket pair, adaptation": (adapting, socket_pair),
        "socket pair, hold": (holding, socket_pair),
        "socket pair, two notches": (notched, socket_pair),
    }
    for text, (one_loop, bus) in buses.items():
        one, other = one_loop.run("numba", bus, cycles).rows, one_loop.run("C", bus, cycles).rows
        report.facts[f"{text}: estimated ticks"] = int((one["flags"] & tick.FLAG_ESTIMATED_VELOCITY != 0).sum())
        differing = differing_fields(one, other)
        report.facts[f"{text}: ticks that learn"] = int((one["flags"] & tick.FLAG_ADAPTS != 0).sum())
        report.facts[f"{text}: ticks that hold"] = int((one["hold_a"] != 0.0).sum())
        report.facts[f"{text}: ticks with an error behind notches"] = int(
            (np.abs(one["filtered_error_rps"] - one["error_rps"]) > 0.0).sum()
        )
        report.facts[f"{text}: differing fields"] = differing
        report.facts[f"{text}: largest command"] = float(np.abs(one["current_command_a"]).max())
        if differing:
            raise RuntimeError(f"not the same work: {', '.join(differing)} differ between numba and C")
    variants = {
        f"{text}, {language}": (lambda one=one, bus=bus, language=language: figures_of(one.run(language, bus, cycles)))
        for text, (one, bus) in buses.items()
        for language in ("numba", "C")
    }
    with shown(NAME) as progress:
        found = interleaved(variants, passes_of(chosen), progress)
    for text in buses:
        ours, theirs = found[f"{text}, numba"], found[f"{text}, C"]
        report.ratio(f"{text}: median cycle, numba over C", paired_ratio(ours["median"], theirs["median"]), TARGET)
        report.ratio(f"{text}: least cycle, numba over C", paired_ratio(ours["least"], theirs["least"]))
        report.ratio(f"{text}: 99th percentile, numba over C", paired_ratio(ours["p99"], theirs["p99"]), LATE_TARGET)
    report.table(
        ("variant", "least cycle, us", "median, us", "99 %, us"),
        [
            (name, *(f"{np.median(figures[key]) / 1e3:.2f}" for key in ("least", "median", "p99")))
            for name, figures in found.items()
        ],
    )
    report.notes += [
        f"{passes_of(chosen)} passes of {cycles} cycles each; C by {compiler_version()}, -O2.",
        "Both loops write the same rows, bit for bit, except for the fields of the clock.",
        "The drive answers in the same thread, outside the measured time; cycles follow one another without a pause.",
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)
