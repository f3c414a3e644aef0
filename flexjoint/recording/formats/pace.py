"""PACE trajectories (.pt): time, dof_pos and des_dof_pos as tensors in a dictionary, written by torch.save.

Only tensors and plain containers are read (`weights_only`): the pickle in a .pt file could run any code else.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from flexjoint.core.errors import MissingExtraError
from flexjoint.recording.logs.log import Documented, Log, names_in, of_arrays, unreadable
from flexjoint.recording.messages import refusal
from flexjoint.recording.table import MOST_BYTES

KIND = "PACE trajectory"
SUFFIXES = (".pt", ".pth")
FIELDS = {
    "dof_pos": Documented("q", "rad", "PACE records angles of Isaac Lab: radians"),
    "dof_vel": Documented("dq", "rad/s", "PACE records angles of Isaac Lab: radians"),
    "des_dof_pos": Documented("q_ref", "rad", "PACE records angles of Isaac Lab: radians"),
}


def read(path: Path) -> Log:
    """A log of the tensors.

    Raises RecordingError with what is wrong with the file, MissingExtraError where torch is not installed.
    """
    try:
        import torch
    except ImportError:
        raise MissingExtraError("torch", "torch") from None
    if path.stat().st_size > MOST_BYTES:
        raise refusal(path, f"more than {MOST_BYTES:g} bytes; cut the log")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about pickles that it then refuses
            content = torch.load(path, map_location="cpu", weights_only=True)
    except (
        Exception
    ) as error:  # torch raises errors of its archives and of its unpickler, without a common base
        if "weights" in str(error).lower() or type(error).__name__ == "UnpicklingError":
            raise refusal(
                path, "holds more than tensors, which could run code; save a dictionary of tensors alone"
            ) from None
        raise unreadable(str(path), KIND, error) from None
    if not isinstance(content, dict):
        raise refusal(path, f"expected a dictionary of tensors, got {type(content).__name__}")
    arrays: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, torch.Tensor):
            arrays[str(name)] = value.detach().to(torch.float64).numpy()
        elif isinstance(value, list | tuple) and value and all(isinstance(word, str) for word in value):
            arrays[str(name)] = np.array(value)
    return of_arrays(str(path), KIND, arrays, names_in(arrays), FIELDS)
