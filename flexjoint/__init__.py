"""Simulate, analyse and diagnose robots with series elastic actuators and flexible joints.

The values that pass from stage to stage, and what reads and writes them, are named here; the stages are
functions in the module of their name: `flexjoint.simulate.simulate`, `flexjoint.compare.compare`,
`flexjoint.diagnose.diagnose`. Nothing is imported before it is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flexjoint.compare import Comparison
    from flexjoint.diagnosis import Diagnosis
    from flexjoint.effect import Effect, catalogue, plan
    from flexjoint.errors import FlexJointError
    from flexjoint.live import LiveSimulation
    from flexjoint.model import FlexibleJointModel
    from flexjoint.recording import Recording
    from flexjoint.recording import read as read_recording
    from flexjoint.recording import write as write_recording
    from flexjoint.robot import Robot
    from flexjoint.robot import load as load_robot
    from flexjoint.robot import write as write_robot
    from flexjoint.symbolic_functions import rigid_body_functions

__all__ = [
    "Comparison",
    "Diagnosis",
    "Effect",
    "FlexJointError",
    "FlexibleJointModel",
    "LiveSimulation",
    "Recording",
    "Robot",
    "catalogue",
    "load_robot",
    "plan",
    "read_recording",
    "rigid_body_functions",
    "write_recording",
    "write_robot",
]

_PLACES = {
    "Comparison": ("compare", "Comparison"),
    "Diagnosis": ("diagnosis", "Diagnosis"),
    "Effect": ("effect", "Effect"),
    "FlexJointError": ("errors", "FlexJointError"),
    "FlexibleJointModel": ("model", "FlexibleJointModel"),
    "LiveSimulation": ("live", "LiveSimulation"),
    "Recording": ("recording", "Recording"),
    "Robot": ("robot", "Robot"),
    "rigid_body_functions": ("symbolic_functions", "rigid_body_functions"),
    "catalogue": ("effect", "catalogue"),
    "load_robot": ("robot", "load"),
    "plan": ("effect", "plan"),
    "read_recording": ("recording", "read"),
    "write_recording": ("recording", "write"),
    "write_robot": ("robot", "write"),
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'flexjoint' has no attribute {name!r}")
    module, attribute = _PLACES[name]
    return getattr(importlib.import_module(f"flexjoint.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
