"""What sensor noise and nominal numbers must not be taken for."""

from __future__ import annotations

from dataclasses import replace

from diagnose_cases import SENSORS, Case, as_recording, nominal
from planting import ROBOTS, Planted, plant

from flexjoint.diagnose.balances import balances_of
from flexjoint.diagnose.fit import fit, shifts
from flexjoint.diagnose.workspace import Workspace
from flexjoint.effect import plan as planned


def test_a_friction_at_rest_takes_no_noise() -> None:
    """A friction of a hundred-thousandth of the joint's torque holds nothing: it must not seem to explain the
    noise of a healthy machine that often stands still (it took 190 when it held what was measured)."""
    case = Case("lever", "steps", 4, "noisy_feedback")
    workspace = Workspace(balances_of(nominal(case.robot), as_recording(case.with_causes())))
    tiny = planned("motor_coulomb_friction", "swing", {"level": 1e-4})
    nothing, rubbing = (workspace.energy(workspace.residual(extra)) for extra in ([], [tiny]))

    assert abs(nothing - rubbing) < 10.0  # less than any price


def test_deviations_are_taken_together_with_their_products() -> None:
    """With encoder offsets of 0.02 rad a spring 2 % off pulls by K times both: beyond first order."""
    known = nominal("gimbal")
    offsets = [
        Planted(f"{side}_encoder_offset", joint, {"offset": size})
        for joint in known.joint_names
        for side, size in (("link", 0.02), ("motor", -0.02))
    ]
    recorded = plant(ROBOTS / "gimbal.yaml", offsets, "slow", 8.0, 3, SENSORS["full"], inexact=0.02)
    unknown = replace(known, file=known.file.model_copy(update={"offsets": "per_recording"}))
    workspace = Workspace(balances_of(unknown, as_recording(recorded)))
    nothing = fit(workspace, [])
    held = workspace.whitened([*workspace.nominal, *shifts(nothing)])

    assert float(held @ held) < 1.3 * workspace.noise_energy
