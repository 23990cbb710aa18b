"""The tick: one compiled function that holds no GIL, for a drive on a bus and a simulated one alike.

At the deadline: empty the receive queue, SYNC -> feedback until the cut-off -> reference -> controller -> envelope ->
command -> row -> housekeeping (heartbeat, one service frame). A command of sample k acts at SYNC k+1. Nothing in here
allocates, logs, raises, or waits for another thread.

`runtime.requests` takes what ordinary threads ask for and knows when the loop has to end, `runtime.tick` has the pieces
of the tick, `runtime.row` records it. What is remembered goes from tick to tick in records; what hands on large ones
is inlined (`njit(inline="always")`), or they would be copied at every call: a tenth of the cycle.
"""

from __future__ import annotations

from typing import Any

from ..control.adaptation import bounds_reached
from ..control.envelope import TRIP_NONE, EnvelopeConfig
from ..control.reference import MODE_IDLE
from ..control.set_point import no_motion
from ..control.velocity_estimator import keep_command
from ..drive.port import port_command, port_housekeeping
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from . import blocks as b
from .blocks import Blocks, give_memory, memory_is_asked_for
from .memory import LoopMemory
from .requests import (
    begin_stopping,
    law_at_start,
    read_requests,
    stops_here,
    supervise,
    supervision_at_start,
    take_blocks,
    take_reset,
    without_torque,
)
from .ring import HEAD, Ring
from .row import Target, publish_tick, write_row
from .tick import (
    LoopConfig,
    ProfileCursor,
    count_reset,
    exchange,
    flags_of,
    follow_profile,
    follow_set_points,
    guard_at_start,
    guard_step,
    law_step,
    learn,
    look,
    send,
    timing_before,
    wake,
    with_learned,
)


@njit
def run_loop(
    port: Any, config: LoopConfig, envelope_config: EnvelopeConfig, blocks: Blocks, scratch: Any, ring: Ring,
    first_deadline_ns: int,
) -> int:  # fmt: skip
    """Run until STOP, the end of the profile (AUTOSTOP) or `max_ticks`. Returns the number of ticks that ran.

    A supervisor that is silent for `supervisor_ticks` has left the axis alone: quick stop, then the end, and with it of
    our heartbeat.

    `scratch` (2, CONTROLLER_BLOCK_SIZE) float64: copy under way, and parameters in use. The last thing sent is a zero
    command with the voltage disabled.
    """
    control = blocks.control
    status = blocks.status
    feedback = port.feedback[0]
    law_in_use, memory = law_at_start(blocks, scratch)
    guard = guard_at_start(blocks, feedback)
    supervision = supervision_at_start(blocks)
    cursor = ProfileCursor(status[b.PROFILE_DONE], -1, 0, MODE_IDLE)
    live = no_motion(status[b.SET_POINT_DONE])
    controlword = 0
    head = load_acquire(ring.words, HEAD)
    last = timing_before(config, first_deadline_ns)
    ticks_run = 0
    ends = False

    while not ends:
        timing = exchange(port, config, status, wake(port, config, status, last))
        elapsed_ticks = timing.tick - last.tick  # with those that were skipped

        # what ordinary threads ask for; the number first: what it counts is seen below
        request_number = load_acquire(control, b.REQUEST_NUMBER)
        law_in_use, memory = take_blocks(blocks, scratch, law_in_use, memory)
        guard = take_reset(blocks, feedback, guard)
        supervision = supervise(blocks, config, supervision, feedback["statusword"], timing.tick, elapsed_ticks)
        asked = read_requests(blocks, config, supervision, guard, feedback["statusword"], request_number)

        # where the axis is to go
        was_running = cursor.start_tick >= 0
        cursor, sample, reference = follow_profile(
            blocks, cursor, law_in_use.config.feedforward, timing.tick, asked.active and live.start_tick < 0,
            config.tail_ticks,
        )  # fmt: skip
        if was_running and cursor.start_tick < 0 and load_acquire(control, b.AUTOSTOP) != 0:
            supervision, asked = begin_stopping(supervision), without_torque(asked)
        live, live_sample, set_point_rps, live_reference = follow_set_points(
            blocks, live, law_in_use.config.feedforward, config, timing.tick, feedback, asked.active,
            cursor.start_tick < 0,
        )  # fmt: skip
        if live_sample >= 0:
            reference = live_reference

        # law, envelope, command
        law, memory = law_step(
            blocks, law_in_use.config, memory, cursor.mode, timing, feedback, asked.toggle, asked.effects,
            asked.active, reference,
        )  # fmt: skip
        seen = look(feedback, config, timing, guard.baseline, law, asked.wanted, asked.enabled, elapsed_ticks - 1)
        command_a, limits, guard, memory = guard_step(envelope_config, status, timing.tick, guard, memory, law, seen)
        sent = send(port, envelope_config, timing, guard, asked.goal, seen, controlword, command_a)
        controlword = sent.controlword
        keep_command(blocks.commands, timing.tick, sent.current_a)

        # what is kept of it
        adapts, learned = learn(law_in_use.config, memory.learned, memory.adapted, law, memory.controller)
        status[b.ADAPTED_TO_BOUND] = bounds_reached(law_in_use.config.adaptation, learned)
        flags = flags_of(seen, ticks_run == 0, law.estimate.estimated, adapts)
        target = Target(sample, cursor.number, live_sample, live.number, set_point_rps)
        row = write_row(
            ring, head, timing, config, law_in_use, asked, target, law, memory, guard, seen, feedback, command_a,
            limits, sent, flags,
        )  # fmt: skip
        memory = with_learned(memory, learned)
        head += 1
        publish_tick(ring, head, status, timing, row)
        port_housekeeping(port, timing.tick, guard.trip != TRIP_NONE)
        if memory_is_asked_for(blocks):
            give_memory(blocks, head, LoopMemory(memory, guard.envelope, live))

        guard = count_reset(guard)
        ticks_run += 1
        ends, supervision = stops_here(blocks, config, supervision, seen.statusword, ticks_run)
        last = timing

    port_command(port, last.tick, 0, 0.0)
    store_release(status, b.FINISHED, 1)
    return ticks_run
