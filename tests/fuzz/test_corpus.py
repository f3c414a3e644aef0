"""Files that once broke something (a traceback, a crash, a hang, a wrong robot): refused in words, for ever.

Named reason.suffix; a robot file stands with `arm2.urdf` beside it, a description is loaded alone, a table is
a recording, a JSON a diagnosis. Who finds another one puts it there.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.hostile import corpus, only_refusals
from support import fake_diagnosis
from support.robots.robot_files import URDF

from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.followup import experiment
from flexjoint.recording import table as recording
from flexjoint.recording.importing import open_log
from flexjoint.robot import robot

READ = {
    ".yaml": robot.load,
    ".urdf": robot.load,
    ".xml": robot.load,
    ".sdf": robot.load,
    ".csv": recording.read,
    ".mcap": open_log,
}


@pytest.mark.parametrize("path", [item for suffix in READ for item in corpus(suffix)])
def test_what_broke_once_is_refused(tmp_path: Path, path: Path) -> None:
    (tmp_path / "arm2.urdf").write_text(URDF)
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    with only_refusals(), pytest.raises(FlexJointError) as error:
        READ[path.suffix](copy)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("path", corpus(".json"))
def test_a_diagnosis_that_broke_once_is_refused(tmp_path: Path, path: Path) -> None:
    with only_refusals(), pytest.raises(FlexJointError):
        experiment.read(path, fake_diagnosis.arm(tmp_path))
