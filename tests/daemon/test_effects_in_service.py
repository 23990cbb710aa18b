"""Effects of a model in a daemon: adopted over the API at rest alone, shown, and taken out when tracking gets worse."""

from __future__ import annotations

import time

import pytest
import yaml
from daemon.rig import PATIENCE_S, CommandedNode, Rig, edit
from daemon.test_supervisor import refused

from fffo_drive.cli import main
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.core import Node
from fffo_drive.drive.simulated.node.simulated_plant import SimulatedPlant
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.runtime import blocks as b

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

# its error is far larger than that of a stalling machine: four pairs of windows are enough even there
AMPLITUDE_NM, ORDER = 0.1, 2.0
PLANT = PlantConfig(
    effects=(EffectConfig("cogging", {"amplitude_nm": AMPLITUDE_NM, "order": ORDER, "phase_rev": 0.0}),)
)
SINE = {"kind": "sine", "duration_s": 29, "amplitude": 3, "frequency_hz": 2}
ELASTIC = {"share": 0.05, "frequency_hz": 40.0, "damping": 0.03}
LAG = {"name": "elasticity", "parameters": {name: {"value": value} for name, value in ELASTIC.items()}}


class PlantNode(CommandedNode):
    """A node with the simulated drive's own plant, which has cogging in it."""

    def __init__(self, bus, config):
        super().__init__(bus, config)
        self.node = Node(config, SimulatedPlant(config.plant))


class PlantRig(Rig):
    """A daemon and that node, whose time is made of SYNCs: a machine that stalls stalls the axis with it.

    Windows of the monitor are whole periods of the sine.
    """

    def __init__(self, directory):
        super().__init__(directory)
        edit(self.path, self.forgive)

    @staticmethod
    def forgive(axis):
        axis["controller"]["effects"] = {"monitor_window_s": 0.5}
        axis["envelope"].update(speed_limit_rps=500, following_error_rps=500)
        axis["loop"]["cutoff_share"] = 0.9

    def new_node(self, faults=()):
        config = NodeConfig(sync_loss_tolerance_ms=10_000, plant=PLANT, step_by_sync=True)
        return PlantNode(self.bus, config)

    def model_with(self, *effects):
        """The axis' model with effects, as text."""
        model = yaml.safe_load((self.path.parent / "model.yaml").read_text())
        return yaml.safe_dump({**model, "effects": list(effects)}, sort_keys=False)

    def run_until(self, client, condition):
        """Keep the sine running until the status is so."""
        deadline_s = time.monotonic() + 3.0 * PATIENCE_S
        status = client.call("status")
        while not condition(status):
            assert time.monotonic() < deadline_s, status
            assert status["state"] != "fault", status
            if status["state"] == "enabled":
                client.act("start", profile=SINE)
            time.sleep(0.1)
            status = client.call("status")
        return status


def cogging(sin_nm):
    return {"name": "cogging", "parameters": {"sin_nm": {"value": sin_nm}, "order": {"value": ORDER}}}


@pytest.mark.long
def test_an_effect_is_adopted_at_rest_shown_and_taken_out_when_it_does_harm(tmp_path, capsys):
    with PlantRig(tmp_path) as rig:
        client = rig.client()
        status = rig.until("ready", client)
        assert status["effects"] == {"monitor": "not watched", "list": []}

        # the right one, beside one that no feed-forward can give
        client.call("model", text=rig.model_with(cogging(-AMPLITUDE_NM), LAG), name="right.yaml")
        status = client.call("status")
        assert status["effects"]["monitor"] == "on trial"
        assert [item["in_service"] for item in status["effects"]["list"]] == [True, False]
        assert "not known in advance" in status["effects"]["list"][1]["reason"]
        assert main(["ctl", "--sockets", str(rig.sockets), "status"]) == 0
        shown = capsys.readouterr().out
        assert "effects in service: cogging (on trial)" in shown
        assert "effect not in service: elasticity: its torque is not known in advance" in shown

        client.call("enable")
        wrong = rig.model_with(cogging(AMPLITUDE_NM))
        refused(lambda: client.call("model", text=wrong), "model", "enabled", "ready")
        status = rig.run_until(client, lambda s: s["effects"]["monitor"] == "watched")
        assert status["effects"]["list"][0] == {"name": "cogging", "in_service": True, "reason": None}
        assert "cogging in service: squared tracking error -" in rig.events("effects")[-1]["text"]
        client.call("disable")

        # the sign turned
        client.call("model", text=wrong, name="wrong.yaml")
        client.call("enable")
        status = rig.run_until(client, lambda s: not s["effects"]["list"][0]["in_service"])
        assert status["effects"]["list"][0]["reason"] == "tracking got worse with it"
        event = rig.events("effects")[-1]
        assert event["level"] == "warning"
        assert "cogging taken out of service: squared tracking error +" in event["text"]
        assert event["data"]["in_service"] == "none"
        assert event["text"] in rig.journal.getvalue()
        assert rig.do(lambda: int(rig.supervisor.connection.session.blocks.control[b.EFFECTS])) == 0
        assert status["state"] in ("running", "enabled")  # and the axis goes on

        # it stays out until somebody puts it in service again
        client.call("disable")
        assert not client.call("status")["effects"]["list"][0]["in_service"]
        client.call("model", text=rig.model_with(cogging(-AMPLITUDE_NM)), name="right.yaml")
        assert client.call("status")["effects"]["list"][0]["in_service"]
