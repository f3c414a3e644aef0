"""Simulate, analyse and diagnose robots with series elastic actuators and flexible joints.

    import flexjoint as fj

    robot = fj.load_robot("kr300")
    diagnosis = fj.diagnose(robot, fj.read_recording("rec_A.parquet"))
    print(diagnosis)

The robot or the model comes first, the data second. Nothing is imported before it is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what type checkers and editors see of the table below
    from flexjoint.cli.paper.whole_body import paper_whole_body
    from flexjoint.core.errors import FlexJointError
    from flexjoint.core.parameter import Parameter
    from flexjoint.design.gains import lqr, motor_pd, place
    from flexjoint.design.linearise import linearise
    from flexjoint.design.margins import margins
    from flexjoint.design.robustness import worst_case
    from flexjoint.design.stability_limits import longest_period, scheme_limits, stiffness_locus
    from flexjoint.design.tomei import tomei
    from flexjoint.design.verification import StepTest, verify
    from flexjoint.diagnosis.comparison.compare import Comparison, compare
    from flexjoint.diagnosis.data.check import DataCheck, check_data
    from flexjoint.diagnosis.followup.agreement.agreement import agreement
    from flexjoint.diagnosis.followup.checking.check import check
    from flexjoint.diagnosis.followup.checking.values import Check
    from flexjoint.diagnosis.followup.experiment import Plan, plan
    from flexjoint.diagnosis.followup.learning.learn import learn
    from flexjoint.diagnosis.pipeline import diagnose
    from flexjoint.diagnosis.result import Diagnosis
    from flexjoint.effects import Effect, catalogue, effect
    from flexjoint.export.targets import Exported, export_robot
    from flexjoint.model.dynamics import FlexibleJointModel
    from flexjoint.model.statics.equilibrium import equilibrium
    from flexjoint.model.statics.standing import standing
    from flexjoint.model.statics.static_law import static_error
    from flexjoint.recording.importing import import_log
    from flexjoint.recording.table import Recording
    from flexjoint.recording.table import make as make_recording
    from flexjoint.recording.table import read as read_recording
    from flexjoint.report.view import Motion, still, view
    from flexjoint.rigidbody.functions import rigid_body_functions
    from flexjoint.robot.robot import Robot, shipped_robots
    from flexjoint.robot.robot import load as load_robot
    from flexjoint.simulation import testing
    from flexjoint.simulation.options import RunOptions
    from flexjoint.simulation.runs.live import LiveSimulation
    from flexjoint.simulation.simulate import Simulation, simulate

__all__ = [
    "Check",
    "Comparison",
    "DataCheck",
    "Diagnosis",
    "Effect",
    "Exported",
    "FlexJointError",
    "FlexibleJointModel",
    "LiveSimulation",
    "Motion",
    "Parameter",
    "Plan",
    "Recording",
    "Robot",
    "RunOptions",
    "Simulation",
    "StepTest",
    "agreement",
    "catalogue",
    "check",
    "check_data",
    "compare",
    "diagnose",
    "effect",
    "equilibrium",
    "export_robot",
    "import_log",
    "learn",
    "linearise",
    "load_robot",
    "longest_period",
    "lqr",
    "make_recording",
    "margins",
    "motor_pd",
    "paper_whole_body",
    "place",
    "plan",
    "read_recording",
    "rigid_body_functions",
    "scheme_limits",
    "shipped_robots",
    "simulate",
    "standing",
    "static_error",
    "stiffness_locus",
    "still",
    "testing",
    "tomei",
    "verify",
    "view",
    "worst_case",
]

_PLACES = {  # name: module and what it is called there
    "Check": ("diagnosis.followup.checking.values", "Check"),
    "Comparison": ("diagnosis.comparison.compare", "Comparison"),
    "DataCheck": ("diagnosis.data.check", "DataCheck"),
    "Diagnosis": ("diagnosis.result", "Diagnosis"),
    "Effect": ("effects", "Effect"),
    "Exported": ("export.targets", "Exported"),
    "FlexJointError": ("core.errors", "FlexJointError"),
    "FlexibleJointModel": ("model.dynamics", "FlexibleJointModel"),
    "LiveSimulation": ("simulation.runs.live", "LiveSimulation"),
    "Motion": ("report.view", "Motion"),
    "Parameter": ("core.parameter", "Parameter"),
    "Plan": ("diagnosis.followup.experiment", "Plan"),
    "Recording": ("recording.table", "Recording"),
    "Robot": ("robot.robot", "Robot"),
    "RunOptions": ("simulation.options", "RunOptions"),
    "Simulation": ("simulation.simulate", "Simulation"),
    "agreement": ("diagnosis.followup.agreement.agreement", "agreement"),
    "StepTest": ("design.verification", "StepTest"),
    "catalogue": ("effects", "catalogue"),
    "check": ("diagnosis.followup.checking.check", "check"),
    "check_data": ("diagnosis.data.check", "check_data"),
    "compare": ("diagnosis.comparison.compare", "compare"),
    "diagnose": ("diagnosis.pipeline", "diagnose"),
    "effect": ("effects", "effect"),
    "equilibrium": ("model.statics.equilibrium", "equilibrium"),
    "export_robot": ("export.targets", "export_robot"),
    "import_log": ("recording.importing", "import_log"),
    "learn": ("diagnosis.followup.learning.learn", "learn"),
    "linearise": ("design.linearise", "linearise"),
    "load_robot": ("robot.robot", "load"),
    "longest_period": ("design.stability_limits", "longest_period"),
    "lqr": ("design.gains", "lqr"),
    "make_recording": ("recording.table", "make"),
    "margins": ("design.margins", "margins"),
    "motor_pd": ("design.gains", "motor_pd"),
    "paper_whole_body": ("cli.paper.whole_body", "paper_whole_body"),
    "place": ("design.gains", "place"),
    "plan": ("diagnosis.followup.experiment", "plan"),
    "read_recording": ("recording.table", "read"),
    "rigid_body_functions": ("rigidbody.functions", "rigid_body_functions"),
    "scheme_limits": ("design.stability_limits", "scheme_limits"),
    "shipped_robots": ("robot.robot", "shipped_robots"),
    "simulate": ("simulation.simulate", "simulate"),
    "standing": ("model.statics.standing", "standing"),
    "static_error": ("model.statics.static_law", "static_error"),
    "stiffness_locus": ("design.stability_limits", "stiffness_locus"),
    "still": ("report.view", "still"),
    "testing": ("simulation", "testing"),
    "tomei": ("design.tomei", "tomei"),
    "verify": ("design.verification", "verify"),
    "view": ("report.view", "view"),
    "worst_case": ("design.robustness", "worst_case"),
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'flexjoint' has no attribute {name!r}{_near(name)}")
    module, attribute = _PLACES[name]
    if name == "testing":
        return importlib.import_module(f"flexjoint.{module}.{attribute}")
    return getattr(importlib.import_module(f"flexjoint.{module}"), attribute)


def __dir__() -> list[str]:
    return __all__


def _near(name: str) -> str:
    """The names that come close, as the end of a message."""
    from difflib import get_close_matches

    near = get_close_matches(name, __all__)
    return f"; did you mean {' or '.join(near)}?" if near else "; dir(flexjoint) lists its names"
