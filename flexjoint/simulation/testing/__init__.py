"""Tests of robots, for pytest or any other runner: a check that fails raises AssertionError and says why.

    from flexjoint import testing

    def test_it_moves_as_it_did():
        run = testing.golden_run(MODEL, simulated(), rate=20.0)
        testing.assert_golden(run, HERE / "golden" / "elbow_step.parquet", {"q": 1e-9, "tau_t": 1e-6})

Golden runs are made anew by `record_golden` or with FLEXJOINT_GOLDEN=record in the environment, and never
else. What cannot be checked as asked is a FlexJointError, not a failed check. docs/howto/testing.md has the
story.
"""

from flexjoint.simulation.testing.differences import Difference, Tolerance, assert_golden, differences
from flexjoint.simulation.testing.energy import EnergyBalance, assert_energy_balance, energy_balance
from flexjoint.simulation.testing.golden import About, GoldenRun, golden_run, read_golden, record_golden
from flexjoint.simulation.testing.limits import assert_limits
from flexjoint.simulation.testing.repeat import assert_deterministic
from flexjoint.simulation.testing.rest import assert_static_law

__all__ = [
    "About",
    "Difference",
    "EnergyBalance",
    "GoldenRun",
    "Tolerance",
    "assert_deterministic",
    "assert_energy_balance",
    "assert_golden",
    "assert_limits",
    "assert_static_law",
    "differences",
    "energy_balance",
    "golden_run",
    "read_golden",
    "record_golden",
]
