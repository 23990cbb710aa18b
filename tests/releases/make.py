"""Makes the files of a release that are kept in tests/releases/VERSION, with the program of this checkout.

    fffo-drive close-the-loop configs/axis_undeclared.yaml --sim configs/simulated_undeclared.yaml --quick --out CIRCLE
    PYTHONPATH=.:tests python -m releases.make tests/releases/VERSION CIRCLE

Record, recordings on a bus and the torn file come from real time: they differ from run to run, and the tests beside
this file hold the values of the kept ones.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.daemon.client import ClientError, DaemonClient
from fffo_drive.fleet.prior import Population
from fffo_drive.fleet.store import FleetStore
from fffo_drive.identification.facts import read_facts
from fffo_drive.recording.reader import describe

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
LIMITS = {
    "current_limit_a": 14,
    "continuous_current_a": 8.3,
    "speed_limit_rps": 25,
    "following_error_rps": 8,
    "following_error_s": 0.2,
    "position_window_rev": [-100, 100],
    "feedback_missing_ticks": 200,
    "status_missing_ticks": 400,
    "heartbeat_timeout_s": 2,
    "reactions": {"overspeed": "coast"},
}
LAW = {
    "proportional_a_per_rps": 0.975,
    "integral_a_per_rev": 9.75,
    "current_limit_a": 12,
    "observer": {"toggle": "ff", "gain_nm_per_rev": 5, "clamp_ratio": 2, "feedback_band_rps": 0.1},
    "feedforward": {"inertia": True, "preview": True, "delay_aware": True},
    "error_filter_s": 2e-4,
    "effects": {"monitor": False},
}
SINE = {"kind": "sine", "duration_s": 0.3, "amplitude": 2, "frequency_hz": 5}
PATIENT = {"heartbeat_timeout_ms": 1000, "command_timeout_ms": 200}
SIMULATED = {
    "format": "fffo_drive/simulated/1",
    "node_id": 1,
    "sync_loss_tolerance_ms": 500,
    "realtime_priority": 0,
    "plant": {"seed": 7, "effects": [{"name": "cogging", "parameters": {"amplitude_nm": 0.01}}]},
}
FACTS = {
    "torque_constant_nm_per_a": 0.148,
    "rated_current_a": 8.3,
    "gear_ratio": 1.0,
    "resolver_bits": 15,
    "sample_rate_hz": 2000,
    "pole_pairs": 4,
    "slots": 12,
    "nominal_delay_s": 0.003,
    "absolute_angle": True,
    "units": "rotary",
    "columns": {"time_s": "t", "velocity_rps": {"column": "speed", "unit": "rpm"}},
}
SCENARIO = {
    "format": "fffo_drive/scenario/1",
    "name": "kept",
    "axis": "axis_simulated.yaml",
    "seeds": 3,
    "first_seed": 5,
    "reference": {"kind": "paper", "duration_s": 2},
    "plant": {"friction": {"kind": "single_2sep"}},
    "mismatch": {"friction_share": 0.1, "signs": "high", "factors": {"coulomb_nm": 1.2}},
    "percent_of": "pi",
    "controllers": {"pi": {"toggle": "off"}, "pi+fffo": {"toggle": "ff", "error_filter_s": 0.0002}},
}
PROFILES = {
    "gentle": {"kind": "sine", "duration_s": 0.4, "amplitude": 1, "frequency_hz": 5},
    "steps": {"kind": "points", "mode": "current", "points": [[0, 0], [0.1, 0.2], [0.2, 0]]},
    "all": {"kind": "identify", "duration_s": 5, "low_a": 0.1, "high_a": 0.4},
}


def write(path: Path, content: object) -> Path:
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def fffo(*words: object) -> None:
    code = main([str(word) for word in words])
    assert code == 0, (words, code)


def patiently_connected(path: Path) -> DaemonClient:
    for _ in range(600):
        try:
            return DaemonClient(path)
        except ClientError:
            time.sleep(0.1)
    raise SystemExit(f"no daemon on {path}")


def make(out: Path, circle: Path) -> None:
    out.mkdir(parents=True)
    # files
    shutil.copy(CONFIGS / "models" / "table1.yaml", out / "model.yaml")
    shutil.copy(circle / "diagnosis" / "model.yaml", out / "model_with_effects.yaml")
    shutil.copy(circle / "diagnosis" / "report.json", out / "diagnosis.json")
    history = yaml.safe_load((circle / "axis.adoptions.yaml").read_text())
    history["adoptions"][-1] |= {"model": "model_with_effects.yaml", "former": "model.yaml"}  # no path of this machine
    write(out / "axis_simulated.adoptions.yaml", history)
    write(out / "simulated.yaml", SIMULATED)
    facts = write(out / "facts.yaml", FACTS)
    read_facts(facts)
    simulated = write(out / "axis_simulated.yaml", {
        "format": "fffo_drive/axis/1", "name": "kept", "drive": {"kind": "simulated", "file": "simulated.yaml"},
        "model": "model_with_effects.yaml", "controller": LAW, "envelope": LIMITS,
        "loop": {"rate_hz": 1000, "tail_s": 0.05}, "profile": SINE,
    })  # fmt: skip
    write(out / "scenario.yaml", SCENARIO)
    port = free_loopback_port()
    bus = f"loopback:{port}"
    canopen = write(out / "axis_canopen.yaml", {
        "format": "fffo_drive/axis/1", "name": "kept",
        "drive": {
            "kind": "canopen", "bus": "loopback:29500", "node_id": 1, "resolver_bits": 15,
            "velocity_units_per_rps": 32768, "rated_torque_nm": 1.2284, "rated_current_a": 8.3, **PATIENT,
        },
        "model": "model.yaml", "controller": LAW | {"accept_unproven": False}, "envelope": LIMITS,
        "loop": {"rate_hz": 500, "tail_s": 0.1},
        "realtime": {"priority": 0, "cpu": "any", "lock_memory": False, "required": False},
        "recording": {"directory": "runs", "flush_interval_s": 0.1, "rotate_bytes": 1_000_000_000},
        "profile": SINE, "commissioning": "commissioning.yaml",
        "daemon": {"supervisor_timeout_s": 5, "scope": 8700, "foxglove": "127.0.0.1:8765", "profiles": PROFILES},
    })  # fmt: skip
    FleetStore(str(out / "fleet"), create=True)
    shutil.move(out / "fleet" / "store.json", out / "store.json")
    shutil.rmtree(out / "fleet")
    population = Population(("coulomb_nm",), np.array([0.025]), np.eye(1) * 1e-5, np.eye(1) * 1e-6, 12)
    write(out / "population.yaml", population.as_plain())
    # recordings
    work = out.parent / f"{out.name}.work"
    shutil.copytree(out, work)
    fffo("run", work / simulated.name, "--out", out / "run.mcap")
    edited = yaml.safe_load(canopen.read_text())
    edited["daemon"] |= {"scope": None, "foxglove": None}
    axis = write(work / canopen.name, edited)
    command = [sys.executable, "-m", "fffo_drive"]
    node = subprocess.Popen([*command, "sim", str(out / "simulated.yaml"), "--bus", bus])
    try:
        time.sleep(20)
        fffo("commission", axis, "--yes", "--bus", bus, "--out", out / "commissioning.yaml")
        shutil.copy(out / "commissioning.yaml", work)
        daemon = subprocess.Popen([*command, "serve", str(axis), "--bus", bus, "--sockets", str(work / "s")], cwd=work)
        try:
            with patiently_connected(work / "s" / "control.sock") as client:
                while client.call("status")["state"] != "ready":
                    time.sleep(0.1)
                client.call("enable")
                client.call("record", to="on")
                client.call("start", profile="gentle", wait_s=10)
                client.call("set", key="controller.proportional_a_per_rps", value=0.9)
                client.call("start", profile="gentle", wait_s=10)
                (whole,) = client.call("record", to="off")["files"]
                shutil.copy(work / whole, out / "daemon.mcap")
                client.call("record", to="on")
                client.call("start", profile="gentle", wait_s=10)
                part = next(path for path in (work / "runs").glob("*.part"))
                shutil.copy(part, out / "torn.mcap.part")
                client.call("disable")
        finally:
            daemon.terminate()
            daemon.wait()
    finally:
        node.terminate()
        node.wait()
    with (out / "torn.mcap.part").open("r+b") as torn:  # inside its last chunk
        torn.truncate((out / "torn.mcap.part").stat().st_size - 100)
    for path in sorted(out.iterdir()):
        print(f"{path.name:<32} {path.stat().st_size}")
        if "mcap" in path.name:
            described = describe(path)
            print(json.dumps({key: described[key] for key in ("complete", "reason", "rows", "metadata", "summary")}))


if __name__ == "__main__":
    make(Path(sys.argv[1]), Path(sys.argv[2]))
