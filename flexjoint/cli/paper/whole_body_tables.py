"""The tables of section 5.2: what is left at rest, and what the durations of the motion do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.cli.paper import whole_body
from flexjoint.cli.paper.grid import Grid
from flexjoint.cli.paper.whole_body import TIMING, Run, Timing
from flexjoint.core.running.progress import Report, silent
from flexjoint.simulation.options import Engine

LAW = (
    "l: the contact forces lambda. any: the largest of all joints but the wheels. law: the largest difference"
    " from the static law (theta_d - q_d) - (tau_t - tau_ff)/Kp - tau_t/K."
)
DURATIONS = (
    "The paper states no durations. They set the speeds and torques of the way. At rest the arms' errors are"
    " the same; the legs' follow the forces along the ground that the wheels have not let go of. Speeds and"
    " torques are the largest of hips and knees as they move."
)
FIRST = ("none", "link")  # the variant that gives the paper's picture
# [s] other durations than ours: a quick and a slow move, a longer stand
OTHERS = (TIMING, replace(TIMING, move=2.0), replace(TIMING, move=8.0), replace(TIMING, hold=14.0))


def variants() -> list[tuple[str, str]]:
    return [(gravity, motor) for gravity in whole_body.GRAVITY for motor in whole_body.MOTOR]


def grids(engine: Engine, report: Report = silent) -> list[Grid]:
    """All tables; they take a minute of simulated motion for each variant and each choice of durations."""
    names = whole_body.robot_model().robot.joint_names
    shown = {label: names.index(joint) for label, joint in whole_body.SHOWN.items()}
    count = len(variants()) + len(OTHERS) - 1
    rows = []
    for k, (gravity, motor) in enumerate(variants()):
        title = f"{whole_body.GRAVITY[gravity]}; {whole_body.MOTOR[motor]}"
        report(k / count, f"tau_ff {title}")
        for hold in whole_body.run(gravity, motor, engine).holds:
            errors = [f"{1e3 * hold.error[i]:+.1f}" for i in shown.values()]
            worst = whole_body.largest(hold.error), whole_body.largest(hold.error - hold.law)
            rows.append([title, hold.pose, *errors, f"{1e3 * worst[0]:.1f}", f"{1e3 * worst[1]:.0e}"])
    head = ["tau_ff; theta_d", "pose", *shown, "any", "law"]
    held = Grid("q - q_d at rest, in mrad", head, rows, ("pose",), LAW)
    rows = []
    for k, timing in enumerate(OTHERS):
        report((len(variants()) - 1 + k) / count, "other durations")
        run = whole_body.run(*FIRST, engine, timing)
        rows += _durations(run, timing, list(shown.values()))
    head = ["move; stand [s]", "pose", *shown, "speed [rad/s]", "tau_m [N m]"]
    of = f"tau_ff {whole_body.GRAVITY[FIRST[0]]}, theta_d = {whole_body.MOTOR[FIRST[1]]}"
    report(1.0, "")
    return [held, Grid(f"{of}: q - q_d at rest, in mrad", head, rows, ("pose",), DURATIONS)]


def _durations(run: Run, timing: Timing, places: list[int]) -> list[list[str]]:
    """A row for each pose: errors, and the largest speed and motor torque of the leg's joints on the way."""
    model, tape = whole_body.robot_model(), run.trajectory
    rows = []
    for k, hold in enumerate(run.holds):
        begin = round((timing.wait + k * timing.leg + timing.steer) * whole_body.PHYSICS)
        way = slice(begin, begin + round(timing.move * whole_body.PHYSICS))
        legs = [i for i, joint in enumerate(model.joints) if joint.name.startswith(("hip", "knee"))]
        speed = np.abs(tape.v[way][:, [model.joints[i].idx_v for i in legs]]).max()
        torque = np.abs(tape.tau_m[way][:, legs]).max()
        errors = [f"{1e3 * hold.error[i]:+.1f}" for i in places]
        rows.append(
            [f"{timing.move:g}; {timing.hold:g}", hold.pose, *errors, f"{speed:.2f}", f"{torque:.0f}"]
        )
    return rows
