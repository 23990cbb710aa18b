"""Runs in which anything is asked for at any tick, recorded, and what their replay says."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from evaluation.gated import GatedDrive, GatedRun

from fffo_drive.config.axis import AxisFile, build_profile, controller_config, model_note
from fffo_drive.config.effects import compensation_table
from fffo_drive.config.sections import AdaptationSection, VelocitySection
from fffo_drive.config.session import session_config
from fffo_drive.control.compensation import ALL_EFFECTS
from fffo_drive.control.reference import MODE_CURRENT, MODE_VELOCITY, piecewise_linear, sine
from fffo_drive.control.set_point import SetPoint
from fffo_drive.drive.cia402 import GOAL_DISABLED, GOAL_ENABLED, GOAL_QUICK_STOP
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.evaluation.replay_runs import Replayer
from fffo_drive.model.parameters import EffectModel, Quantity, read_model
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.settings import RecorderHooks, RecorderSettings, RotationPolicy
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.session import Session
from fffo_drive.workflows.replay import with_continuations

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = AxisFile.model_validate({
    "name": "asked", "drive": {"kind": "simulated", "file": "none"}, "model": "none",
    "controller": {
        "proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 6,
        "feedforward": {"inertia": True, "preview": True, "delay_aware": True},
    },
    "envelope": {
        "current_limit_a": 5, "continuous_current_a": 1, "i2t_time_s": 0.05, "i2t_action": "limit", "slew_a_per_s": 400,
        "speed_limit_rps": 25, "following_error_rps": 8,
    },
    "profile": {"kind": "sine", "duration_s": 0.5, "amplitude": 3, "frequency_hz": 8},
})  # fmt: skip
PERIOD_S = AXIS.loop.period_s
COGGING = {"cos_nm": 0.0, "sin_nm": -0.0075, "order": 6.0}
DRAG = {"drag_nm_per_rps2": 1e-4}
PROFILES = (
    build_profile(AXIS.profile, PERIOD_S),
    sine("short", MODE_VELOCITY, 0.05, PERIOD_S, 8.0, 40.0),
    sine("current", MODE_CURRENT, 0.05, PERIOD_S, 0.8, 20.0),
    piecewise_linear("ramp", MODE_VELOCITY, PERIOD_S, np.array([0.0, 0.1, 0.2]), np.array([0.0, 4.0, 0.0])),
)
EMERGENCY_CODE = 0x3210
FILES = "FFFO_REPLAYED_FILES"


def models() -> list:
    """Table 1 bare, with one effect, and with two."""
    bare = read_model(CONFIGS / "models" / "table1.yaml")

    def effect(name, values):
        return EffectModel(name=name, parameters={key: Quantity(value=value) for key, value in values.items()})

    cogging, drag = effect("cogging", COGGING), effect("quadratic_drag", DRAG)
    return [bare, *(bare.model_copy(update={"effects": effects}) for effects in ([cogging], [drag, cogging]))]


class Ticking:
    """The loop's memory where the recorder waits for it: the loop, which stands between two ticks, goes one further."""

    def __init__(self, session: Session, run: GatedRun) -> None:
        self._session, self._run = session, run
        self.memory_given = session.memory_given

    def ask_for_memory(self) -> int | None:
        number = self._session.ask_for_memory()
        self._run.ticks(1)
        return number


class Asked:
    """One run: requests by name, as the daemon makes them."""

    def __init__(
        self,
        directory: Path,
        seed: int = 1,
        rotate_bytes: int | None = None,
        most_ticks: int = 20_000,
        recorded: bool = True,
    ):
        """`recorded`: from the first row on; else `record` begins."""
        self.models = models()
        self.axis, self.model = AXIS, self.models[1]
        self.resets = 0
        self.path = directory / "run.mcap"
        config = session_config(AXIS, self.model, 4000, 1 << 15)
        self.run = GatedRun(config, GatedDrive(replace(PlantConfig(), seed=seed)))
        self.session = self.run.session
        self._settings = RecorderSettings(flush_interval_s=0.0, rotation=RotationPolicy(max_bytes=rotate_bytes))
        if recorded:
            self.record(0.0)
        self.run.begin(most_ticks)

    def record(self, value: float) -> None:
        """Record from here on; with `value` 1 in the midst of what the loop does, which it says with its next tick."""
        self.recorder = Recorder(
            self.session.ring,
            self.path,
            settings=self._settings,
            hooks=RecorderHooks(clock_ns=lambda: int(self.run.drive.port.inner.words[0])),
            records=self.session.records,
            from_now=value == 1.0,
            memory=Ticking(self.session, self.run) if value == 1.0 else self.session,
        )

    def ask(self, what: str, value: float) -> None:
        """`value` from 0 to 1 chooses among what can be asked for."""
        getattr(self, what)(value)

    def gains(self, value: float) -> None:
        controller = self.axis.controller.model_copy(update={"proportional_a_per_rps": 0.4 + value})
        self.axis = self.axis.model_copy(update={"controller": controller})
        self._publish()

    def velocity(self, value: float) -> None:
        section = VelocitySection(source="estimated" if value >= 0.3 else "drive", bandwidth_hz=50.0 + 300.0 * value)
        controller = self.axis.controller.model_copy(update={"velocity": section})
        self.axis = self.axis.model_copy(update={"controller": controller})
        self._publish()

    def adaptation(self, value: float) -> None:
        """Learn in service, fast; or with 0 no longer."""
        section = AdaptationSection(enabled=value > 0.0, time_s=5.0, bound_share=0.5)
        observer = self.axis.controller.observer.model_copy(update={"learns_in": "integral"})
        controller = self.axis.controller.model_copy(update={"adaptation": section, "observer": observer})
        self.axis = self.axis.model_copy(update={"controller": controller})
        self._publish()

    def other_model(self, value: float) -> None:
        self.model = self.models[round(value * (len(self.models) - 1))]
        self.session.set_model(model_note(self.model))
        self._publish()

    def _publish(self) -> None:
        self.session.set_controller(controller_config(self.axis, self.model))
        self.session.set_effects(compensation_table(self.axis, self.model))

    def toggle(self, value: float) -> None:
        self.session.request(b.TOGGLE, round(2 * value))

    def in_service(self, value: float) -> None:
        self.session.request(b.EFFECTS, (0, 1, 2, ALL_EFFECTS)[round(3 * value)])

    def enable(self, value: float) -> None:
        self.session.request(b.GOAL, GOAL_ENABLED)

    def start(self, value: float) -> None:
        self.session.note_request("pid 1", "start", {"value": value}, epoch=self.resets)
        self.number = self.session.start_profile(PROFILES[round(value * (len(PROFILES) - 1))])

    def set_point(self, value: float) -> None:
        """Some hold for a time, some until the next one."""
        target_rps = (3.0, -2.0, 0.0, 6.5)[round(3 * value)]
        hold_ticks = (0, 40)[round(10 * value) % 2]
        self.session.set_point(SetPoint(target_rps, 100.0, 4e3, hold_ticks, 0.0, 150.0, -0.2, 0.3, 3e-3))

    def abort_set_point(self, value: float) -> None:
        self.session.request(b.SET_POINT_ABORT, int(self.session.blocks.control[b.SET_POINT_NUMBER]))

    def abort(self, value: float) -> None:
        self.session.request(b.PROFILE_ABORT, int(self.session.blocks.control[b.PROFILE_NUMBER]))

    def disable(self, value: float) -> None:
        self.session.request(b.GOAL, GOAL_QUICK_STOP if value > 0.5 else GOAL_DISABLED)

    def fault(self, value: float) -> None:
        self.run.drive.raise_fault(EMERGENCY_CODE)

    def reset(self, value: float) -> None:
        self.run.drive.clear_fault()
        self.resets += 1
        self.session.request(b.RESET_NUMBER, self.resets)

    def drain(self, value: float) -> None:
        self.recorder.drain_once()

    def finish(self) -> list[Path]:
        """The files."""
        self.session.request(b.STOP, 1)
        self.run.end()
        self.recorder.close()
        return with_continuations([self.path])


WHAT = (
    "gains", "other_model", "toggle", "in_service", "enable", "start", "abort", "disable", "fault", "reset", "drain",
    "set_point", "abort_set_point", "velocity",
)  # fmt: skip
STORY = (  # everything at least once, and a motion under most of it
    ("toggle", 0.5, 3), ("enable", 0.0, 40), ("start", 0.0, 200), ("velocity", 0.5, 40), ("gains", 0.3, 61),
    ("in_service", 0.0, 90),
    ("in_service", 1.0, 150), ("other_model", 1.0, 70), ("toggle", 1.0, 33), ("drain", 0.0, 1), ("gains", 0.9, 47),
    ("other_model", 0.0, 21), ("fault", 0.0, 30), ("reset", 0.0, 60), ("other_model", 0.5, 10), ("start", 0.3, 120),
    ("velocity", 0.0, 20), ("toggle", 0.0, 20), ("abort", 0.0, 10), ("velocity", 0.9, 1),
    ("start", 0.6, 60), ("disable", 0.0, 30), ("enable", 0.0, 30),
    ("start", 1.0, 150), ("abort", 0.0, 3), ("set_point", 0.0, 120), ("set_point", 0.35, 60), ("gains", 0.5, 30),
    ("set_point", 1.0, 90), ("abort_set_point", 0.0, 20), ("set_point", 0.1, 700), ("disable", 1.0, 80),
)  # fmt: skip


def tell(directory: Path, story=STORY, drain_each: bool = False, **options) -> list[Path]:
    """Run a story: what, which of it, and how many ticks go by after it. Returns the files in their order."""
    asked = Asked(directory, **options)
    for what, value, ticks in story:
        asked.ask(what, value)
        asked.run.ticks(ticks)
        if drain_each:
            asked.recorder.drain_once()
    return asked.finish()


MOVING = (  # into the midst of a profile, with all that the law remembers
    ("toggle", 0.5, 3),
    ("enable", 0.0, 40),
    ("velocity", 0.5, 5),
    ("adaptation", 1.0, 5),
    ("start", 0.0, 333),
    ("record", 1.0, 150),
    ("gains", 0.3, 60),
    ("abort", 0.0, 10),
    ("set_point", 0.0, 77),
    ("drain", 0.0, 3),
    ("set_point", 1.0, 30),
    ("disable", 1.0, 30),
)
LIVE = (
    ("toggle", 0.5, 3),
    ("velocity", 0.9, 5),
    ("enable", 0.0, 40),
    ("set_point", 0.0, 60),
    ("record", 1.0, 40),
    ("set_point", 0.35, 60),
    ("in_service", 0.0, 20),
    ("disable", 1.0, 30),
)
AT_REST = (("toggle", 0.5, 3), ("enable", 0.0, 400), ("record", 1.0, 120), ("disable", 1.0, 30))
MIDST = {"moving": MOVING, "live": LIVE, "at rest": AT_REST}


def begun_in_the_midst() -> list[str]:
    """For another interpreter: of each story of MIDST whether its recording replays, and the commands in it."""
    said: list[str] = []
    for story in MIDST.values():
        with tempfile.TemporaryDirectory() as directory:
            (file,) = tell(Path(directory), story, recorded=False)
            run = read_run(file)
            replayer = Replayer()
            replayer.take(run.rows, run.records)
        said += [str(replayer.report.exact), *(value.hex() for value in run.rows["limited_a"].tolist())]
    return said


def replayed_files() -> list[str]:
    """For another interpreter: exact or not, rows, and the commands that its replay computes for the files named."""
    replayer = Replayer()
    commands: list[str] = []
    for file in os.environ[FILES].split(os.pathsep):
        run = read_run(file)
        replayed = replayer.take(run.rows, run.records)
        commands += [value.hex() for value in replayed.commands[:, 0].tolist()]
    report = replayer.report
    return [str(report.exact), str(report.all_rows), str(report.rows), *commands]
