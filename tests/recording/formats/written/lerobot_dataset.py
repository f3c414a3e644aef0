"""Writes a small LeRobot dataset with lerobot's own LeRobotDataset: `python lerobot_dataset.py FOLDER`.

README.md beside this file says with which versions it was run. It is not a part of the tests: lerobot needs
torch, and is not among what they install.
"""

import math
import sys

import numpy as np
import torch

# torchvision's compiled part does not load beside a torch that is built for CPUs alone; without it, importing
# torchvision asks for the operators' declarations. Datasets without pictures call none of them.
operators = torch.library.Library("torchvision", "DEF")
for name in ("nms", "qnms"):
    operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402

FPS = 50
JOINTS = ["shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos"]
FRAMES = (60, 80)  # of the two episodes


def degrees(t: float, joint: int, episode: int) -> float:
    """40 sin((2 + joint) t + joint + episode), the measured angle."""
    return 40.0 * math.sin((2.0 + joint) * t + joint + episode)


joints = {"dtype": "float32", "shape": (len(JOINTS),), "names": JOINTS}
dataset = LeRobotDataset.create(
    repo_id="local/arm",
    fps=FPS,
    features={"observation.state": joints, "action": joints},
    robot_type="arm",
    root=sys.argv[1],
    use_videos=False,
)
for episode, frames in enumerate(FRAMES):
    for frame in range(frames):
        state = [degrees(frame / FPS, j, episode) for j in range(len(JOINTS))]
        row = {
            "observation.state": np.array(state, dtype=np.float32),
            "action": np.array(state, dtype=np.float32) + np.float32(1.0),
        }
        if hasattr(dataset, "finalize"):  # 0.4
            dataset.add_frame({**row, "task": "swing"})
        else:  # 0.3
            dataset.add_frame(row, task="swing")
    dataset.save_episode()
if hasattr(dataset, "finalize"):
    dataset.finalize()
