"""Fig. 8 and 9 of the paper: an arm's shoulder and elbow, a leg's hip yaw and hip pitch."""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.cli.paper import whole_body
from flexjoint.cli.paper.grid import Grid
from flexjoint.cli.paper.page import Page, Section
from flexjoint.cli.paper.whole_body import Run
from flexjoint.cli.paper.whole_body_tables import FIRST
from flexjoint.core.running.progress import Report, silent
from flexjoint.report import plots
from flexjoint.report.plots import Image
from flexjoint.simulation.options import Engine

LEAD = (
    "CENTAURO on its wheels goes from its initial pose to a spider's and a mammal's: section 5.2, with the"
    " controller at 1 kHz and physics at 2 kHz. The paper gives no trajectories, gains or numbers for this"
    " experiment, but says what its figures show: joints that gravity loads keep a position error, as the"
    " shoulder, the elbow and the hip pitch, and the hip yaw's goes to zero.",
    "Poses, the motion between them, durations and gains are ours (docs/studies/whole_body.md).",
)
FIGURES = (
    ("Fig. 8: shoulder pitch and elbow", ("shoulder", "elbow")),
    ("Fig. 9: hip yaw and hip pitch", ("hip yaw", "hip pitch")),
)
STRIDE = whole_body.PHYSICS // whole_body.CONTROL  # rows of a trajectory for each tick
LEGEND = (
    ("measured", "reference q_d, dq_d"),
    ("before", "motor theta, dtheta, tau_m"),
    ("after", "link q, dq; transmission tau_t"),
)


def page(tables: Sequence[Grid], engine: Engine, report: Report = silent) -> Page:
    """The page of what `whole_body_tables.grids` gave."""
    report(0.0, "drawing")
    run = whole_body.run(*FIRST, engine)
    said = "No feed-forward torque and theta_d = q_d, which gives the paper's picture."
    sections = [Section(title, (said,), LEGEND, _figure(run, names)) for title, names in FIGURES]
    report(0.5, "drawing")
    sections.append(
        Section(
            "What each feed-forward torque leaves",
            ("q - q_d over time, theta_d = q_d.",),
            (("before", "none"), ("measured", "g(q_d)"), ("after", "g(q_d) - J_c' lambda")),
            _errors(engine),
            tables[:1],
        )
    )
    sections.append(Section("What the durations do", grids=tables[1:]))
    report(1.0, "")
    return Page("CENTAURO from pose to pose", LEAD, sections)


def _figure(run: Run, labels: Sequence[str]) -> list[list[Image]]:
    """Positions, velocities and torques, one row each, of two joints."""
    columns = [_joint(run, label) for label in labels]
    return [list(row) for row in zip(*columns, strict=True)]


def _joint(run: Run, label: str) -> list[Image]:
    model, commands = whole_body.robot_model(), whole_body.references(run.gravity, run.motor)
    tape, ticks = run.trajectory, whole_body.plan().time
    i = model.robot.joint_names.index(whole_body.SHOWN[label])
    joint, k = model.joints[i], model.flexible.index(i)
    wanted, speed = ((ticks, commands[name][:, i]) for name in ("q_ref", "dtheta_ref"))
    q, v = tape.q[:, joint.idx_q], tape.v[:, joint.idx_v]
    theta, dtheta = tape.theta[:, k], tape.dtheta[:, k]
    spring = joint.drive.K * (theta - q) + joint.drive.D * (dtheta - v)
    t = tape.time
    return [
        plots.curves("position [rad]", f"{label}: positions", wanted, (t, theta), (t, q)),
        plots.curves("velocity [rad/s]", f"{label}: velocities", speed, (t, dtheta), (t, v)),
        plots.curves("torque [N m]", f"{label}: torques", None, (t, tape.tau_m[:, i]), (t, spring)),
    ]


def _errors(engine: Engine) -> list[list[Image]]:
    """q - q_d of the four joints, by feed-forward torque."""
    model, ticks = whole_body.robot_model(), whole_body.plan().time
    images = []
    for label, name in whole_body.SHOWN.items():
        i = model.robot.joint_names.index(name)
        curves = {}
        for gravity in whole_body.GRAVITY:
            tape = whole_body.run(gravity, "link", engine).trajectory
            q = tape.q[:-1:STRIDE, model.joints[i].idx_q]
            curves[gravity] = (ticks, 1e3 * (q - whole_body.plan().q[:, i]))
        images.append(
            plots.curves(
                "q - q_d [mrad]", f"{label}: error", curves["gravity"], curves["none"], curves["contact"]
            )
        )
    return [images[:2], images[2:]]
