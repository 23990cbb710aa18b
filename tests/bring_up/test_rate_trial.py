"""The rate that fits, by rows with known times: no loop, no clock."""

from __future__ import annotations

import numpy as np
import pytest
from paper_drive import plain_drive

from fffo_drive.config.sections import LoopSection
from fffo_drive.signals import ROW
from fffo_drive.system.bus import interface_bitrate_hz
from fffo_drive.system.host import Host
from fffo_drive.workflows.axis_draft import Place, make_draft
from fffo_drive.workflows.bring_up import _of_trials
from fffo_drive.workflows.drive_facts import Answers, Fact, drive_facts
from fffo_drive.workflows.rate_trial import (
    Choice,
    RateTrial,
    RoundTrip,
    Spread,
    adapter_problem,
    choose_rate,
    objections,
    problems_at,
    trial_of,
    turnaround_of_drive_us,
)

LOOP = LoopSection()


def rows_of(rate_hz, count=1000, turnaround_us=100.0, late=(), missing=(), skipped=()):
    """Ticks of a loop: `late` ones woke 0.3 of the period late, `missing` ones had no answer, `skipped` never ran."""
    period_ns = 1_000_000_000 // rate_hz
    rows = np.zeros(count, ROW)
    rows["tick"] = np.arange(count)
    rows["deadline_ns"] = 5_000_000_000 + rows["tick"].astype(np.int64) * period_ns
    rows["lateness_ns"] = 10_000
    rows["turnaround_ns"] = round(turnaround_us * 1e3)
    rows["busy_ns"] = round(turnaround_us * 1e3) + 20_000
    rows["lateness_ns"][list(late)] = round(0.3 * period_ns)
    rows["late"][list(late)] = 1
    rows["turnaround_ns"][list(missing)] = -1
    return np.delete(rows, list(skipped))


def test_a_quiet_loop_is_described_by_its_times():
    trial = trial_of(rows_of(1000), 1000, 0.3)
    assert (trial.ticks, trial.missing, trial.late, trial.skipped, trial.longest_gap) == (1000, 0, 0, 0, 0)
    assert trial.turnaround_us == Spread(100.0, 100.0, 100.0)
    assert (trial.jitter_us, trial.sync_jitter_us) == (0.0, 0.0)
    assert trial.lateness_us == Spread(10.0, 10.0, 10.0)
    assert objections(trial, LOOP) == []


def test_what_was_missed_is_counted():
    trial = trial_of(rows_of(1000, late=(5, 6), missing=(20, 21, 22), skipped=(23, 24)), 1000, 0.3)
    assert (trial.ticks, trial.missing, trial.late, trial.skipped) == (998, 3, 2, 2)
    assert trial.longest_gap == 5  # 20 to 24
    # the distance of SYNCs: two of +-290 us in 995 pairs
    assert trial.sync_jitter_us == pytest.approx(np.sqrt(2 * 290.0**2 / 994), rel=0.01)


def test_jitter_is_the_standard_deviation_of_the_turnaround():
    rows = rows_of(2000)
    rows["turnaround_ns"][::2] += 30_000
    trial = trial_of(rows, 2000, 0.6)
    assert trial.jitter_us == pytest.approx(15.0)
    assert trial.turnaround_us.most == pytest.approx(130.0)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (rows_of(2000, turnaround_us=230.0), []),  # 0.8 of 0.6 of 500 us is 240
        (rows_of(2000, turnaround_us=250.0), ["the feedback takes 250 us (99 %), more than 240 us"]),
        (rows_of(2000, missing=(1,)), []),
        (rows_of(2000, missing=(1, 2)), ["2 of 1000 SYNCs had no feedback before the cut-off at 300 us"]),
        (rows_of(2000, late=range(10)), []),
        (rows_of(2000, late=range(11)), ["this machine woke the loop late 11 times in 1000 periods"]),
        (rows_of(2000, skipped=range(100, 111)), ["this machine woke the loop late 11 times in 989 periods"]),
        (rows_of(2000, missing=range(1000)), ["no feedback after SYNC"]),
        (rows_of(2000)[:0], ["the loop did not run"]),
    ],
)
def test_the_margins_of_the_loop_decide(rows, said):
    found = objections(trial_of(rows, 2000, 0.6), LOOP)
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True))


def test_a_tick_that_takes_longer_than_its_period_does_not_fit():
    rows = rows_of(2000)
    rows["busy_ns"] = 600_000
    assert objections(trial_of(rows, 2000, 0.6), LOOP) == ["a tick takes 600 us (99 %) of a period of 500 us"]


def test_the_highest_rate_that_fits_and_why_the_next_one_does_not():
    good = [trial_of(rows_of(rate), rate, 0.1) for rate in (500, 1000, 2000)]
    assert choose_rate(good, LOOP) == Choice(2000, "It is the highest rate that the program tries.")
    slow = trial_of(rows_of(2000, turnaround_us=260.0), 2000, 0.6)
    assert choose_rate([*good[:2], slow], LOOP).rate_hz == 1000
    assert choose_rate([*good[:2], slow], LOOP).reason.startswith("2000 Hz does not fit: the feedback takes 260")
    refused = RateTrial(1000, "refuses 0x60C2:02 = -4")
    assert choose_rate([good[0], refused], LOOP) == Choice(500, "1000 Hz does not fit: refuses 0x60C2:02 = -4")
    assert choose_rate([refused], LOOP) == Choice(None, "1000 Hz does not fit: refuses 0x60C2:02 = -4")
    disturbed = trial_of(rows_of(500, late=range(20)), 500, 0.1)
    assert choose_rate([disturbed, *good[1:]], LOOP).rate_hz == 2000  # a moment of this machine is no reason
    assert choose_rate(good, LOOP, lambda rate: ["too long"] * (rate == 2000)).reason == (
        "2000 Hz does not fit: too long"
    )


def draft_on(bus):
    objects = plain_drive()
    facts = drive_facts(objects, Answers(), 1)
    return make_draft(Place("axis", "m.yaml", bus, Fact(1_000_000, ""), 1, "a drive"), facts, objects)


def test_the_sum_for_the_bus_has_a_word_in_it():
    draft = draft_on("socketcan:can0")
    assert problems_at(draft.axis, draft.model, 2000, 20.0) == []
    assert problems_at(draft.axis, draft.model, 2000, 300.0)[0].startswith("SYNC, feedback and command take")
    assert problems_at(draft.axis, draft.model, 1000, 300.0) == []


def test_the_drives_own_turnaround_is_what_wire_and_adapter_leave():
    trials = [trial_of(rows_of(rate, turnaround_us=400.0), rate, 0.1) for rate in (500, 1000)]
    # 8 data bytes take at most 135 us at 1 Mbit/s, SYNC 55 us: an adapter of 215 us needs 80 us of its own
    trip = RoundTrip(Spread(215.0, 250.0, 300.0), Spread(500.0, 600.0, 700.0))
    assert turnaround_of_drive_us(trials, trip, draft_on("socketcan:can0").axis) == pytest.approx(
        400.0 - (135 + 55) - (215 - 135)
    )
    assert turnaround_of_drive_us(trials, None, draft_on("socketcan:can0").axis) is None
    assert turnaround_of_drive_us(trials, trip, draft_on("loopback:29500").axis) is None


def test_an_adapter_on_usb_is_refused_above_500_hz(tmp_path):
    commands = tmp_path / "commands"
    commands.mkdir()
    (commands / "ip -details -json link").write_text(
        '[{"ifname": "can0", "link_type": "can", "flags": ["UP"], "txqlen": 16, "linkinfo": {"info_kind": "can", '
        '"info_data": {"bittiming": {"bitrate": 1000000}, "restart_ms": 100, "state": "ERROR-ACTIVE"}}}]'
    )
    device = tmp_path / "sys/class/net/can0/device"
    device.mkdir(parents=True)
    (device / "driver").symlink_to("/drivers/gs_usb")
    (device / "subsystem").symlink_to("/bus/usb")
    assert interface_bitrate_hz(Host(tmp_path), "socketcan:can0") == 1_000_000
    assert interface_bitrate_hz(Host(tmp_path), "socketcan:can1") is None
    assert interface_bitrate_hz(Host(tmp_path), "loopback:29500") is None
    assert adapter_problem("socketcan:can0", 500, 1_000_000, Host(tmp_path)) == ""
    assert adapter_problem("socketcan:can0", 1000, 1_000_000, Host(tmp_path)).startswith(
        "can can0 driver: gs_usb on USB: refused at 1000 Hz"
    )
    assert adapter_problem("loopback:29500", 2000, 1_000_000, Host(tmp_path)) == ""


def findings_of(trials, rate_hz, bus="socketcan:can0"):
    draft = draft_on(bus)
    axis = draft.axis.model_copy(update={"loop": LoopSection(rate_hz=rate_hz)})
    return [f"{one.level}: {one.subject}" for one in _of_trials(trials, choose_rate(trials, LOOP), axis, draft.model)]


def test_what_the_trials_say_of_machine_and_bus():
    good = [trial_of(rows_of(rate), rate, 0.1) for rate in (500, 1000, 2000)]
    assert findings_of(good[:2], 1000) == []
    assert findings_of(good, 2000) == ["warning: bus"]  # the worst case of 2 kHz is beyond its period
    disturbed = trial_of(rows_of(500, late=range(20)), 500, 0.1)
    assert findings_of([disturbed, good[1]], 1000) == ["warning: machine"]
    assert findings_of([disturbed], 500) == ["warning: rate"]
    assert findings_of([RateTrial(500, "the drive refuses")], 2000) == ["failure: bring-up"]
    held = [trial._replace(refusals=("SCHED_FIFO is refused",)) for trial in good[:2]]
    assert findings_of(held, 1000) == ["warning: real time"]
