"""Real machines against fits by hand: the motor torque that an extended model leaves on data that its
diagnosis never saw.

PYTHONPATH=. python bench/yardsticks.py [--emps FOLDER]

KR300: diagnosed on recording A, judged on B and C. TX40: diagnosed on the first half of its recording,
judged on the second. EMPS (a linear drive; its data may not be shipped): FOLDER holds emps.yaml,
emps_train_fj.csv and emps_pulses_fj.csv; diagnosed on the first, judged on the second. The fits by hand were
made by an engineer with friction, offsets and known couplings. Judged along the motion of the motors. The
extended model has the likely causes alone: no nominal number is corrected.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import flexjoint as fj
from flexjoint.diagnosis.verdict.unseen.torques import torque_errors

ROBOTS = Path(__file__).parents[1] / "robots"
BY_HAND = {
    "kr300": (228.0, 458.0, 354.0, 59.0, 91.0, 43.0),
    "tx40": (4.0, 3.9, 1.35, 0.65, 1.06, 0.72),
    "emps": (2.2,),
}  # N m, N


def judged(name: str, robot: fj.Robot, seen: fj.Recording, others: Sequence[fj.Recording]) -> None:
    """Print what the extended model of one recording leaves on others, beside the nominal one and a fit by
    hand."""
    started = time.perf_counter()
    diagnosis = fj.diagnose(robot, seen)
    seconds = time.perf_counter() - started
    extended = diagnosis.extend(robot)
    print(f"\n{name}: {diagnosis.verdict}, {seconds:.0f} s for a recording of {seen.duration:.0f} s")
    for f in diagnosis.findings:
        print(f"  {f.probability:.2f}  {f.effect} {f.joint or ''}")
    print(f"  {'joint':<12}{'judged on':<22}{'nominal':>10}{'extended':>10}{'by hand':>10}")
    for whole in others:
        # links follow through the model's springs where both encoders are read: what a stiff joint's link
        # encoder is off by, times its stiffness, is more torque than any error of the model
        recording = replace(whole, columns={key: x for key, x in whole.columns.items() if key[0] != "q"})
        before, after = (torque_errors(model, recording) for model in (robot, extended))
        for joint, by_hand in zip(robot.joint_names, BY_HAND[name], strict=True):
            left = (before[joint], after[joint], by_hand)
            print(f"  {joint:<12}{Path(recording.name).name:<22}" + "".join(f"{x:>10.3g}" for x in left))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--emps", type=Path, metavar="FOLDER")
    parser.add_argument("--only", choices=list(BY_HAND), help="one machine")
    given = parser.parse_args()
    if given.only in (None, "tx40"):
        robot = fj.load_robot("tx40")
        whole = fj.read_recording(ROBOTS / "tx40" / "recordings" / "rec.parquet")
        begin, half = whole.time[0], 0.5 * (whole.time[0] + whole.time[-1])
        judged("tx40", robot, whole.between(begin, half), [whole.between(half, whole.time[-1])])
    if given.only in (None, "kr300"):
        a, b, c = (
            fj.read_recording(ROBOTS / "kr300" / "recordings" / f"rec_{x}.parquet") for x in ("A", "B", "C")
        )
        judged("kr300", fj.load_robot("kr300"), a, [b, c])
    if given.emps and given.only in (None, "emps"):
        train, pulses = (fj.read_recording(given.emps / f"emps_{x}_fj.csv") for x in ("train", "pulses"))
        judged("emps", fj.load_robot(given.emps / "emps.yaml"), train, [pulses])


if __name__ == "__main__":
    main()
