"""The command `flexjoint plan`: the next experiment, as a reference to drive and in words."""

from __future__ import annotations

import argparse
import math
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from flexjoint.cli import options
from flexjoint.cli import outputs as cli_outputs
from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import all_or_none, write_json
from flexjoint.core.messages import escaped
from flexjoint.core.running.progress import silent
from flexjoint.core.units import of_joint
from flexjoint.diagnosis.followup import experiment as planning
from flexjoint.diagnosis.followup.experiment import DECISIVE, Outlook, Plan
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording import table as recording
from flexjoint.report.progress import Progress
from flexjoint.robot.robot import Robot

BEYOND = 6.0  # decimal digits of odds, beyond which a number says nothing more


def run(arguments: argparse.Namespace) -> None:
    """Plan, write the reference, say what to expect. Raises FlexJointError on unusable input."""
    inputs = [arguments.diagnosis] if arguments.diagnosis is not None else []
    inputs += [Path(arguments.robot)]
    cli_outputs.check_place(arguments.out, (".csv", ".parquet"), inputs)
    if arguments.json is not None:
        cli_outputs.check_place(arguments.json, (".json",), [*inputs, arguments.out])
    if arguments.seed < 0:
        raise FlexJointError(f"seed must be 0 or more, got {arguments.seed}")
    loaded = options.load_chosen(arguments)
    if loaded.floating:
        raise FlexJointError(f"{loaded.name} has a floating base; motions are planned for a fixed one only")
    seconds = USUAL.plan.seconds if arguments.seconds is None else arguments.seconds
    reach = USUAL.plan.reach if arguments.reach is None else arguments.reach
    limits = planning.limits_of(loaded, seconds, reach, arguments.speed)
    if arguments.diagnosis is None:
        question = planning.without_diagnosis(loaded)
    else:
        question = planning.read(arguments.diagnosis, loaded)
    with Progress() as bar:
        progress = silent if arguments.quiet else bar
        plan = planning.plan(loaded, question, limits, arguments.seed, progress)
    with all_or_none():
        recording.write(plan.reference, arguments.out)
        if arguments.json is not None:
            write_json(arguments.json, content(plan, loaded, arguments.out))
    if not arguments.quiet:
        _print(plan, loaded, arguments.out)


def _print(plan: Plan, loaded: Robot, out: Path) -> None:
    console = Console()

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    rows = []
    for i, (name, (travel, speed, torque)) in enumerate(plan.peaks.items()):
        limit = plan.limits
        reach = max(limit.high[i] - limit.centre[i], limit.centre[i] - limit.low[i])
        most = f" of {limit.torque[i]:.3g}" if math.isfinite(limit.torque[i]) else ""
        unit = partial(of_joint, prismatic=name in loaded.prismatic)
        cells = (
            f"{travel:.3g} of {reach:.3g} {unit('rad')}",
            f"{speed:.3g} of {limit.speed[i]:.3g} {unit('rad/s')}",
            f"{torque:.3g}{most} {unit('N m')}",
        )
        rows.append((name, *cells))
    say(f"{plan.limits.seconds:g} s of motion for {loaded.name}; in simulation it takes at most")
    cli_outputs.print_table(console, ("joint", "travel from centre", "speed", "motor torque"), rows)
    for line in sentences(plan):
        say(line)
    say(f"wrote {escaped(str(out))}")


def content(plan: Plan, robot: Robot, out: Path) -> dict[str, Any]:
    """The JSON form of a plan whose reference was written to `out` (docs/reference/formats.md)."""
    return {
        "schema": 1,
        "robot": robot.name,
        "reference": str(out),
        "seconds": plan.limits.seconds,
        "expected": sentences(plan),
        "joints": [
            {"joint": joint, "travel": travel, "speed": speed, "torque": torque}
            for joint, (travel, speed, torque) in plan.peaks.items()
        ],
        "ties": [_tie(outlook) for outlook in plan.outlooks],
        "shown": [{"effect": effect, "joint": joint} for effect, joint in plan.shown],
        "hidden": [{"effect": effect, "joint": joint} for effect, joint in plan.hidden],
    }


def _tie(outlook: Outlook) -> dict[str, Any]:
    found, rival = outlook.tie.names
    return {
        "found": found,
        "rival": rival,
        "decided": outlook.decided,
        "log_odds_if_found": outlook.if_found,
        "log_odds_if_rival": outlook.if_rival,
        "proposals": [{"what": p.what, "log_odds": p.log_odds} for p in outlook.proposals],
    }


def sentences(plan: Plan) -> list[str]:
    """What the planned recording is expected to decide, and what to add where it does not."""
    lines = [line for outlook in plan.outlooks for line in _outlook(outlook)]
    if not plan.outlooks:
        total = len(plan.shown) + len(plan.hidden)
        lines.append(f"It excites {len(plan.shown)} of {total} effects of the catalogue, counted by joint.")
        by_effect: dict[str, list[str]] = {}
        for effect, joint in plan.hidden:
            by_effect.setdefault(effect, []).append(joint or "the robot")
        missed = "; ".join(f"{effect} on {', '.join(joints)}" for effect, joints in by_effect.items())
        lines += [f"Not: {missed}."] if missed else []
    return lines


def _outlook(outlook: Outlook) -> list[str]:
    found, rival = outlook.tie.names
    first, other = _odds(outlook.if_found), _odds(outlook.if_rival)
    odds = f"expected odds {first} if it is the first, {other} if the other"
    if outlook.decided:
        return [f"{found}, or {rival}? This motion tells: {odds}."]
    helping = [p for p in outlook.proposals if p.log_odds >= DECISIVE]
    lines = [f"{found}, or {rival}? No motion within the limits decides: {odds}."]
    if helping:
        lines += [f"  Instead: {p.what} (expected odds {_odds(p.log_odds)})." for p in helping]
    else:
        lines.append(
            "  Neither does a known payload nor another sensor of the joints: the two are the same to every"
            " recording. Measure one of them by itself, such as an encoder's zero against a mark."
        )
    return lines


def _odds(log: float) -> str:
    """`20 : 1`, `10^4 : 1`, `beyond 10^6 : 1`."""
    digits = max(log, 0.0) / math.log(10.0)
    if digits > BEYOND:
        return f"beyond 10^{BEYOND:g} : 1"
    return f"{10.0**digits:.2g} : 1" if digits < 3.0 else f"10^{digits:.0f} : 1"
