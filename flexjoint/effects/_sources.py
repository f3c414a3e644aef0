"""Sources that state typical sizes of several effects."""

from flexjoint.effects._base import Source

HARMONIC_DRIVE = Source(
    "Harmonic Drive, manual of the CHA actuators, 2018, page 54",
    "https://manualshive.com/en/manual/harmonic-drive/cha-14a-e/3973040?page=54",
)
TWO_STAGES = Source(
    "Beckhoff, data of the NPT045 planetary gear",
    "https://infosys.beckhoff.com/content/1033/ag3400_ba/9187952779.html",
)
DYNAMIXEL = Source("ROBOTIS, manual of the MX-106", "https://emanual.robotis.com/docs/en/dxl/mx/mx-106-2")
BAM = Source("Rhoban, parameters that BAM identified", "https://github.com/Rhoban/bam")
MANUTEC = Source(
    "Modelica Standard Library, Manutec r3 as DLR measured it",
    "https://github.com/modelica/ModelicaStandardLibrary/blob/1b91ac4227046cd3e87a7ebf840074cb16445cc6/"
    "Modelica/Mechanics/MultiBody/Examples/Systems/RobotR3/FullRobot.mo",
)
_WALKMAN = "https://github.com/geez0x1/CompliantJointToolbox/blob/"
WALKMAN_B11 = Source(
    "Compliant Joint Toolbox, WALK-MAN drive B11, partly identified",
    _WALKMAN + "a9a438a7b811481998849c77c5f4a1f268b50b3e/param/B11.m",
)
WALKMAN_B12 = Source(
    "Compliant Joint Toolbox, WALK-MAN drive B12, partly identified",
    _WALKMAN + "308647d59bbd5faa62f3c8e29c14a19e30ae5bdc/param/B12.m",
)
TORQUE_FLANGE = Source(
    "HBK, terms of torque transducers, with the data of a T10F",
    "https://www.hbkworld.com/en/knowledge/resource-center/articles/"
    "tips-and-tricks-terms-and-expressions-for-specifying-torque-transducers-glossary",
)
HIWIN = Source(
    "HIWIN, manual of the IM-2 torque motors, page 73",
    "https://manualshive.com/en/manual/hiwin/im-2-13/2140493?page=73",
)
TX40 = Source(
    "FIGAROH, parameters of a Staubli TX40",
    "https://github.com/thanhndv212/figaroh-examples/blob/6e6f166c2bcda6967e8f94bbb296e135c9cf842b/"
    "examples/staubli_TX40/config/TX40_config.yaml",
)
