"""Units that a program never writes and always means, by the headings that are its own."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple


class Convention(NamedTuple):
    """A program by a heading that no other one has, and its units by heading: patterns of how one ends."""

    program: str
    mark: str
    units: dict[str, str]


CONVENTIONS = (
    Convention(  # docs.odriverobotics.com: turns and turns per second
        "ODrive",
        r"(pos|vel)_estimate|iq_(measured|setpoint)",
        {
            r"(pos|input_pos)(_estimate|_setpoint)?": "rev",
            r"(vel|input_vel)(_estimate|_setpoint)?": "rps",
            r"[iI][qd]_(measured|setpoint)": "A",
            r"(input_torque|torque_(setpoint|estimate))": "Nm",
        },
    ),
    Convention(  # github.com/mjbots/moteus, reference of the registers
        "moteus",
        r"q_current|servo_stats\.\w+",
        {
            r"(control_)?position": "rev",
            r"(control_)?velocity": "rps",
            r"(control_)?torque": "Nm",
            r"[qd]_current": "A",
        },
    ),
    Convention(  # VESC Tool, CSV of its logger
        "VESC Tool",
        r"ms_today|tachometer_value|q_axis_current",
        {
            r"ms_today": "ms",
            r"current_(motor|in)|[qd]_axis_current": "A",
            r"encoder_position": "deg",
            r"erpm": "erpm",
            r"temp_(motor|mos\w*)": "degC",
        },
    ),
    Convention(  # objects of CiA 402; those of the velocity are the vendor's
        "CiA 402",
        r"0x60(64|77|78|71|7A)\b.*",
        {r"0x60(64|62|7A)\b.*": "counts", r"0x60(71|74|77|78)\b.*": "permille"},
    ),
    Convention(  # mujoco.readthedocs.io: SI, hinge joints in rad
        "MuJoCo",
        r"(qpos|qvel|qfrc_\w+)(\W?\d+\W?)?",
        {r"qpos(\W?\d+\W?)?": "rad", r"qvel(\W?\d+\W?)?": "rad/s", r"(qfrc_actuator|actuator_force)(\W?\d+\W?)?": "Nm"},
    ),
    Convention(  # sensor_msgs/JointState
        "ROS",
        r"/?joint_states.*",
        {r"position(\[\w+\])?": "rad", r"velocity(\[\w+\])?": "rad/s", r"effort(\[\w+\])?": "Nm"},
    ),
)


def conventional(headings: Iterable[str]) -> tuple[dict[str, str], str]:
    """Heading -> unit of a program that is known by them, and the program; nothing of any other."""
    own = list(headings)
    for program, mark, units in CONVENTIONS:
        if any(_ends(name, mark) for name in own):
            found = {name: unit for name in own for end, unit in units.items() if _ends(name, end)}
            return found, program
    return {}, ""


def _ends(heading: str, pattern: str) -> bool:
    return re.search(rf"(?:^|[./ ])(?:{pattern})$", heading, re.IGNORECASE) is not None
