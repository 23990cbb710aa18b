"""Control a daemon (fffo-drive serve) over its sockets. The commands are the methods of its API.

Commands marked "read-only" also work for users who may open only the read-only socket.

--axis is needed if more than one daemon runs. Profile and model files are read here and sent to the daemon, which needs
no access to them. Exit codes: 69 no daemon, 70 refused or fault, 78 bad input.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from ..daemon import rpc
from ..daemon.client import CallError, ClientError, DaemonClient
from ..daemon.parameters import DEFAULT_PROFILE, METHODS, Method, Motion
from ..daemon.serving import find_socket
from ..documents import DocumentError, parse, read_text, sentence
from .exits import EXIT_BAD_INPUT, EXIT_DRIVE_FAULT, EXIT_UNAVAILABLE

RENEWED_SHARE = 0.25  # of the time within which a set point has to be renewed
BAD_INPUT = (rpc.BAD_DOCUMENT, rpc.INVALID_PARAMS, rpc.METHOD_NOT_FOUND, rpc.INVALID_REQUEST, rpc.PARSE_ERROR)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand, made from the table of methods."""
    parser.add_argument("--axis", metavar="NAME", help="which daemon: name of its directory (vcan0, bench)")
    parser.add_argument("--sockets", metavar="DIR", help="directory of the daemon's sockets")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    commands = parser.add_subparsers(dest="method", metavar="COMMAND", required=True)
    for name, method in METHODS.items():
        text = f"{method.summary}{' (read-only)' if method.watching else ''}"
        described = sentence(method.summary)
        command = commands.add_parser(name.replace("_", "-"), help=text, description=described)
        command.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON object")
        for field, info in method.parameters.model_fields.items():
            _add_parameter(command, field, info)


def _add_parameter(command: argparse.ArgumentParser, name: str, info: FieldInfo) -> None:
    """A required parameter has a place, others a flag; `cli: file` is read from a file, and names it.

    Without a name `start` runs the `profile:` section of the axis file.
    """
    kind = (info.json_schema_extra or {}).get("cli") if isinstance(info.json_schema_extra, dict) else None
    text = (info.description or "").replace("%", "%%")
    if kind == "profile":  # which the API takes as keys
        text = "name of a profile in the axis file (see `info`), or a YAML file with a `profile:` section (%(default)s)"
    if info.is_required():
        metavar = {"file": "PATH", "profile": "PROFILE"}.get(str(kind), name.upper())
        choices = get_args(info.annotation) if get_origin(info.annotation) is Literal else None
        type_of = float if info.annotation is float else str
        place: dict[str, Any] = {"nargs": "?", "default": DEFAULT_PROFILE} if kind == "profile" else {}
        command.add_argument(
            name, metavar=metavar, type=type_of, choices=choices, help=f"{text}{_choices(choices)}", **place
        )
    elif info.annotation is bool:
        command.add_argument(f"--{name.replace('_', '-')}", action="store_true", dest=name, help=text)
    elif name != "name":
        flag = f"--{name.replace('_', '-')}"
        kinds = get_args(info.annotation) or (info.annotation,)
        kind_of = next((kind for kind in (float, str) if kind in kinds), int)
        command.add_argument(
            flag,
            dest=name,
            type=kind_of,
            default=None,
            metavar="NAME" if kind_of is str else "N",
            help=text if info.default is None else f"{text} ({info.default:g})",
        )


def _choices(choices: tuple[Any, ...] | None) -> str:
    return f": {', '.join(map(str, choices))}" if choices else ""


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    name = options.method.replace("-", "_")
    method = METHODS[name]
    try:
        params = _parameters(method, options)
        path = find_socket(options.axis, options.sockets, method.watching)
        with DaemonClient(path) as client:
            # what somebody types is a deliberate act; what repeats it below keeps to its epoch
            act = client.act if issubclass(method.parameters, Motion) else client.call
            result = act(name, **params)
            _print(name, params, result, options.json)
            if name == "subscribe":
                _follow(client, options.json)
            if name == "enable" and params.get("hold"):
                return _hold(client)
            if result.get("renew_within_s"):
                _keep_turning(client, name, params, result)
        return 0
    except ClientError as error:
        print(f"fffo-drive ctl: {error}", file=sys.stderr)
        return EXIT_UNAVAILABLE
    except CallError as error:
        if options.json:
            print(json.dumps({"error": {"code": error.code, "message": str(error), "data": error.data}}))
        print(f"fffo-drive ctl: {options.method}: {str(error).removeprefix(f'{name}: ')}", file=sys.stderr)
        return EXIT_BAD_INPUT if error.code in BAD_INPUT else EXIT_DRIVE_FAULT


def _parameters(method: Method, options: argparse.Namespace) -> dict[str, Any]:
    """What was given, as the API wants it. Raises DocumentError for a file that cannot be read."""
    params: dict[str, Any] = {}
    for field, info in method.parameters.model_fields.items():
        value = getattr(options, field, None)
        if value is None:
            continue
        kind = (info.json_schema_extra or {}).get("cli") if isinstance(info.json_schema_extra, dict) else None
        if kind == "file":
            params[field] = read_text(Path(value))
            params["name"] = Path(value).name
        elif kind == "profile":
            params[field] = _profile(value)
        elif field == "value":
            params[field] = _number(value)
        else:
            params[field] = value
    return params


def _profile(given: str) -> Any:
    """A name, or the content of a file."""
    if "/" not in given and not given.endswith((".yaml", ".yml")):
        return given
    content, _ = parse(read_text(Path(given)), given)
    return content.get("profile", content) if isinstance(content, dict) else content


def _number(given: str) -> float | bool:
    if given in ("true", "false"):
        return given == "true"
    try:
        return float(given)
    except ValueError:
        raise DocumentError(f"set: {given!r} is no number, and neither true nor false") from None


def _follow(client: DaemonClient, as_json: bool, ends: Callable[[dict[str, Any]], bool] = lambda _: False) -> None:
    """Print what comes until the daemon, the user or a message ends it."""
    message: dict[str, Any] = {}
    while not ends(message):
        message = client.next_notification()
        if as_json:
            print(json.dumps(message), flush=True)
        elif message.get("method") == "event":
            print(_event_line(message["params"]), flush=True)
        else:
            print(_status_line(message["params"]), flush=True)


def _hold(client: DaemonClient) -> int:
    """Stay connected, and be heard; leaving is what the daemon reacts to."""
    print("holding the axis; Ctrl-C releases it (daemon.client_loss)", file=sys.stderr, flush=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    client.call("subscribe", events=True, status_hz=0)

    def lost(message: dict[str, Any]) -> bool:  # frozen, and heard again too late
        event = message.get("params", {})
        return bool(event.get("kind") == "client" and event["data"].get("client_pid") == os.getpid())

    _follow(client, False, lost)
    return EXIT_DRIVE_FAULT


def _keep_turning(client: DaemonClient, method: str, params: dict[str, Any], answer: dict[str, Any]) -> None:
    """Renew a set point in time until Ctrl-C, then end it. Raises CallError when a stop or another set point ends it.

    It names the epoch in which it began: nobody types anything here that would move the axis after a stop.
    """
    print("turning as long as this runs; Ctrl-C ends at standstill", file=sys.stderr, flush=True)
    ended = threading.Event()
    before = {number: signal.signal(number, lambda *_: ended.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        named = {**params, "epoch": answer["epoch"]}
        while not ended.wait(RENEWED_SHARE * answer["renew_within_s"]):
            answer = client.call(method, **named, renews=answer["set_point"])
        client.call("jog", to_rps=0, renews=answer["set_point"], epoch=answer["epoch"])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print(name: str, params: dict[str, Any], result: Any, as_json: bool) -> None:
    if as_json:
        print(json.dumps(result, indent=2), flush=True)
    elif name == "status":
        print(_status_text(result), flush=True)
    elif name == "events":
        print("\n".join(_event_line(event) for event in result["events"]), flush=True)
    elif name in ("info", "schema"):
        print(_plain(result), flush=True)
    elif "at_rest" in result:
        print(_stop_text(result, params.get("wait_s") != 0), flush=True)
    else:
        print(", ".join(f"{key}: {_short(value)}" for key, value in result.items()), flush=True)


def _stop_text(result: dict[str, Any], awaited: bool) -> str:
    """What is seen of a stop."""
    if result["velocity_rps"] is None:
        seen = "no drive answers, so nothing is measured"
    else:
        seen = f"{'at rest' if result['at_rest'] else 'not at rest'}, {result['velocity_rps']:.3g} rps measured"
    taken = "" if awaited or result["reached"] else "taken, its end was not awaited: "
    return f"{taken}{seen}; state: {result['state']}, epoch: {result['epoch']}"


def _status_text(status: dict[str, Any]) -> str:
    lines = [f"{status['state']}, for {status['state_s']:.1f} s, friction {status['toggle']}, model {_model(status)}"]
    if status["fault"]:
        lines.append(f"fault: {status['fault']['text']} ({status['fault']['name']}, tick {status['fault']['tick']})")
    lines += [f"not ready: {text}" for text in status["obstacles"]]
    lines += _effect_lines(status["effects"])
    if status["motion"]:
        motion = status["motion"]
        lines.append(
            f"{motion['velocity_rps']:.4g} rps of {motion['reference_rps']:.4g}, {motion['position_rev']:.4g} rev, "
            f"{motion['current_a']:.3g} A"
        )
    if status["profile"]:
        profile = status["profile"]
        lines.append(f"profile {profile['name']}: sample {profile['sample']} of {profile['samples']}")
    if status.get("set_point"):  # an older daemon has none
        asked = status["set_point"]
        state = ", runs on" if asked.get("run_on") and asked["to_rps"] else ""
        state += ", leads out of the position window: braked" if asked["blocked"] else ""
        lines.append(
            f"{asked['kind']}: to {asked['to_rps']:.4g} rps (set point {asked['number']}){state}; a set point acts "
            f"{asked['latency_s'] * 1e3:.3g} ms later than it is given (preview)"
        )
    if status["loop"]:
        loop = status["loop"]
        wire = [f"{count} {name}" for name, count in loop["exchange"].items() if count]
        lines.append(
            f"tick {loop['tick']}, {loop['late']} late, {loop['skipped']} skipped, {loop['missing_feedback']} without "
            f"feedback; drive: {status['drive']['state']}{'; ' + ', '.join(wire) if wire else ''}"
        )
    recording = status["recording"]
    if recording["on"]:
        trouble = f"; {recording['trouble']}" if recording["trouble"] else ""
        lines.append(f"recording to {recording['file']}, {recording['rows_written']} rows{trouble}")
        if recording.get("disk_life"):  # an older daemon has none
            lines.append(recording["disk_life"]["text"])
    if status.get("disk"):
        lines.append(status["disk"])
    if status["held_by"]:
        lines.append(f"held by {status['held_by']}")
    if stop := status.get("last_stop"):  # an older daemon tells none
        lines.append(f"{stop['text']} at {stop['at'][11:19]} UTC (epoch {stop['epoch']})")
    return "\n".join(lines)


def _effect_lines(effects: dict[str, Any]) -> list[str]:
    """Nothing for a model without effects."""
    if not effects["list"]:
        return []
    serving = [item["name"] for item in effects["list"] if item["in_service"]]
    lines = [f"effects in service: {', '.join(serving) or 'none'} ({effects['monitor']})"]
    others = [item for item in effects["list"] if not item["in_service"]]
    return lines + [f"effect not in service: {item['name']}: {item['reason']}" for item in others]


def _model(status: dict[str, Any]) -> str:
    return f"{status['model']['name']} ({status['model']['hash'][:12]})"


def _status_line(status: dict[str, Any]) -> str:
    motion = status["motion"] or {"velocity_rps": 0.0, "reference_rps": 0.0, "current_a": 0.0}
    return (
        f"{status['state']:9s} {motion['velocity_rps']:9.4f} rps of {motion['reference_rps']:9.4f}, "
        f"{motion['current_a']:8.4f} A"
    )


def _event_line(event: dict[str, Any]) -> str:
    return f"{event['time'][:23]} {event['level']:7s} {event['kind']:10s} {event['text']}"


def _plain(content: dict[str, Any], indent: str = "") -> str:
    lines = []
    for key, value in content.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", _plain(value, indent + "  ")]
        else:
            lines.append(f"{indent}{key}: {_short(value)}")
    return "\n".join(lines)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "-"
    return "-" if value is None else str(value)
