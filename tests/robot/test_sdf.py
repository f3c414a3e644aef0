"""SDF: the same machine as the URDF that it is made of here, wherever its frames lie, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin
import pytest

import flexjoint as fj
from flexjoint.cli.main import main
from flexjoint.core.errors import RobotError, RobotWarning
from flexjoint.robot.draft import draft

EXACT = 1e-12  # of the largest entry: both files hold all digits, and the reader only multiplies poses
LIMITS = ("lower", "upper", "effort", "velocity")


# --- a URDF as an awkward SDF, written here -----------------------------------------------------------------
def words(values: object) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))  # type: ignore[call-overload]


def pose_of(element: Element | None) -> pin.SE3:
    origin = None if element is None else element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    xyz = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
    return pin.SE3(pin.rpy.rpyToMatrix(*map(float, origin.get("rpy", "0 0 0").split())), xyz)


class Awkward:
    """Every link's frame lies elsewhere than its joint, and poses are relative to what the draw says."""

    def __init__(self, urdf: str, seed: int) -> None:
        self.urdf, self.rng = ElementTree.fromstring(urdf), np.random.default_rng(seed)
        self.root = Element("sdf", version="1.9")
        self.model = SubElement(self.root, "model", name="awkward")
        self.known: dict[str, pin.SE3] = {"__model__": pin.SE3.Identity()}

    def text(self) -> str:
        joints = {j.find("child").get("link"): j for j in self.urdf.findall("joint")}  # type: ignore[union-attr]
        links = {str(link.get("name")): link for link in self.urdf.findall("link")}
        (base,) = links.keys() - joints.keys()
        urdf = {base: pin.SE3.Identity()}  # places of the URDF's link frames in the base
        own = {base: pin.SE3.Identity()}  # of the SDF's, which are moved
        left = dict(joints)
        while left:
            for name, joint in list(left.items()):
                parent = joint.find("parent").get("link")  # type: ignore[union-attr]
                if parent in urdf:
                    urdf[str(name)] = urdf[str(parent)] * pose_of(joint)
                    own[str(name)] = urdf[str(name)] * self.somewhere()
                    del left[name]
        for k, (name, link) in enumerate(links.items()):
            self.frame(k)
            element = SubElement(self.model, "link", name=name)
            self.pose(element, own[name], name)
            self.inertial(element, link, own[name].actInv(urdf[name]))
        for joint in self.urdf.findall("joint"):
            self.joint(joint, urdf, own)
        return ElementTree.tostring(self.root, encoding="unicode")

    def somewhere(self) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rng.uniform(-3, 3, 3)), self.rng.uniform(-0.5, 0.5, 3))

    def frame(self, k: int) -> None:
        element, place = SubElement(self.model, "frame", name=f"mark_{k}"), self.somewhere()
        self.pose(element, place, f"mark_{k}")

    def pose(self, element: Element, place: pin.SE3, name: str, to: str | None = None) -> None:
        """`place` is in the model."""
        to = to or str(self.rng.choice(list(self.known)))
        local = self.known[to].actInv(place)
        pose = SubElement(element, "pose")
        if to != "__model__" or self.rng.random() < 0.5:
            pose.set("relative_to", to)
        if self.rng.random() < 0.5:
            pose.set("rotation_format", "quat_xyzw")
            pose.text = words([*local.translation, *pin.Quaternion(local.rotation).coeffs()])
        else:
            pose.text = words([*local.translation, *pin.rpy.matrixToRpy(local.rotation)])
        self.known[name] = place

    def inertial(self, element: Element, link: Element, at: pin.SE3) -> None:
        given = link.find("inertial")
        inertial = SubElement(element, "inertial")
        mass, moments = 1e-30, dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
        if given is not None:
            mass = float(given.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
            moments = dict(given.find("inertia").attrib)  # type: ignore[union-attr]
            place = at * pose_of(given)
            angles = pin.rpy.matrixToRpy(place.rotation)
            SubElement(inertial, "pose").text = words([*place.translation, *angles])
        SubElement(inertial, "mass").text = repr(mass)
        inner = SubElement(inertial, "inertia")
        for key, value in moments.items():
            SubElement(inner, key).text = value

    def joint(self, joint: Element, urdf: dict[str, pin.SE3], own: dict[str, pin.SE3]) -> None:
        name, kind = str(joint.get("name")), str(joint.get("type"))
        parent, child = (str(joint.find(end).get("link")) for end in ("parent", "child"))  # type: ignore[union-attr]
        element = SubElement(self.model, "joint", name=name, type=kind)
        SubElement(element, "parent").text = parent
        SubElement(element, "child").text = child
        if self.rng.random() < 0.5:  # in the child, as SDF has it where nothing is said
            local = own[child].actInv(urdf[child])
            angles = pin.rpy.matrixToRpy(local.rotation)
            SubElement(element, "pose").text = words([*local.translation, *angles])
            self.known[name] = urdf[child]
        else:
            self.pose(element, urdf[child], name)
        if kind == "fixed":
            return
        given = joint.find("axis")
        along = np.array([float(x) for x in ("1 0 0" if given is None else given.get("xyz", "")).split()])
        axis = SubElement(element, "axis")
        xyz = SubElement(axis, "xyz")
        if self.rng.random() < 0.5:
            to = str(self.rng.choice(list(self.known)))
            xyz.set("expressed_in", to)
            along = self.known[to].rotation.T @ urdf[child].rotation @ along
        xyz.text = words(along)
        limit, given_limit = SubElement(axis, "limit"), joint.find("limit")
        for key in LIMITS if given_limit is not None else ():
            SubElement(limit, key).text = given_limit.get(key, "-1")
        dynamics, stated = SubElement(axis, "dynamics"), joint.find("dynamics")
        for key in ("damping", "friction"):
            SubElement(dynamics, key).text = "0" if stated is None else stated.get(key, "0")


@pytest.mark.parametrize("name", ["kr300", "tx40"])
@pytest.mark.parametrize("seed", [0, 1])
def test_it_is_the_machine_of_the_urdf(name: str, seed: int, tmp_path: Path) -> None:
    given = fj.load_robot(name)
    assert given.description is not None
    text = given.description.text
    (tmp_path / "same.urdf").write_text(text)
    (tmp_path / "same.sdf").write_text(Awkward(text, seed).text())
    urdf, sdf = fj.load_robot(tmp_path / "same.urdf"), fj.load_robot(tmp_path / "same.sdf")
    assert sdf.joint_names == urdf.joint_names
    for key in (
        "lowerPositionLimit",
        "upperPositionLimit",
        "effortLimit",
        "velocityLimit",
        "damping",
        "friction",
    ):
        assert getattr(sdf.model, key) == pytest.approx(getattr(urdf.model, key)), key
    rng = np.random.default_rng(seed)
    for _ in range(5):
        q = rng.uniform(-2.0, 2.0, urdf.model.nq)
        masses, loads = [], []
        for robot in (urdf, sdf):
            data = robot.model.createData()
            masses.append(pin.crba(robot.model, data, q).copy())
            loads.append(pin.computeGeneralizedGravity(robot.model, data, q).copy())
        for one, other in (masses, loads):
            assert np.max(np.abs(other - one)) < EXACT * np.max(np.abs(one))


def test_init_writes_the_robot_file_of_an_sdf(tmp_path: Path) -> None:
    text = fj.load_robot("tx40").description.text  # type: ignore[union-attr]
    (tmp_path / "arm.sdf").write_text(Awkward(text, 3).text())
    out = tmp_path / "arm.yaml"
    out.write_text(draft(str(tmp_path / "arm.sdf"), out).text)
    assert "sdf: arm.sdf" in out.read_text()
    assert fj.load_robot(out).joint_names == fj.load_robot("tx40").joint_names


@pytest.mark.filterwarnings("ignore:.*its spring is not read")
@pytest.mark.parametrize("name", ["kr300", "tx40", "panda", "ur5", "rrbot"])
def test_an_exported_sdf_comes_back(name: str, tmp_path: Path) -> None:
    """Mass matrix, gravity and bias forces at random positions and velocities."""
    robot = fj.load_robot(name)
    fj.export_robot(robot, "sdf", tmp_path / "arm.sdf")
    back = fj.load_robot(tmp_path / "arm.sdf")
    assert list(back.model.names) == list(robot.model.names)
    rng = np.random.default_rng(7)
    for _ in range(5):
        q, v = rng.uniform(-2.0, 2.0, robot.model.nq), rng.uniform(-3.0, 3.0, robot.model.nv)
        same_machine(robot.model, back.model, q, v, 1e-9)  # angles of a pose have 15 digits


def same_machine(one: pin.Model, other: pin.Model, q: np.ndarray, v: np.ndarray, exact: float) -> None:
    """Both have the same mass matrix, gravity torques and bias forces, to a share of the largest entry."""
    (data, back) = (model.createData() for model in (one, other))
    for compute in (
        lambda model, data: pin.crba(model, data, q).copy(),
        lambda model, data: pin.computeGeneralizedGravity(model, data, q).copy(),
        lambda model, data: pin.nonLinearEffects(model, data, q, v).copy(),
    ):
        expected, got = compute(one, data), compute(other, back)
        assert np.max(np.abs(got - expected)) <= exact * max(float(np.max(np.abs(expected))), 1.0)


# --- every form of a pose, by hand ------------------------------------------------------------------------
BODY = "<mass>{0}</mass><inertia><ixx>0.03</ixx><iyy>0.02</iyy><izz>0.04</izz><ixy>0.001</ixy></inertia>"
HALF = math.pi / 2.0
FORMS = f"""<sdf version="1.9"><model name="forms" canonical_link="base" placement_frame="foot">
<pose degrees="true">0.1 0 0 90 0 0</pose>
<frame name="foot" attached_to="__model__"><pose>0 0 0.2 0 0 0</pose></frame>
<frame name="raised"><pose relative_to="foot">0 0 0.3 0 0 0</pose></frame>
<frame name="bolt" attached_to="upper"><pose relative_to="raised">0 0 1 0 0 {HALF!r}</pose></frame>
<link name="base"><inertial>{BODY.format(5)}</inertial></link>
<link name="upper"><pose relative_to="shoulder"/>
<inertial><pose>0.1 0 0.2 0.3 0 0</pose>{BODY.format(3)}</inertial></link>
<link name="lower"><pose relative_to="bolt" rotation_format="quat_xyzw">0.5 0 0 0 0 0 1</pose>
<inertial><pose relative_to="lower">0 0.1 0 0 0 0</pose>{BODY.format(2)}</inertial></link>
<link name="tool"><pose relative_to="lower">0 0 0.4 0 0 0</pose><inertial>{BODY.format(1)}</inertial></link>
<joint name="shoulder" type="revolute"><pose relative_to="raised">0 0 0 0 0 0</pose>
<parent>base</parent><child>upper</child><axis><xyz expressed_in="__model__">0 1 0</xyz>
<limit><lower>-1</lower><upper>2</upper><effort>30</effort><velocity>4</velocity></limit>
<dynamics><damping>0.5</damping><friction>0.25</friction></dynamics></axis></joint>
<joint name="elbow" type="continuous"><pose>-0.1 0 0 0 0 0</pose>
<parent>bolt</parent><child>lower</child><axis><xyz expressed_in="bolt">1 0 0</xyz></axis></joint>
<joint name="slide" type="prismatic"><parent>lower</parent><child>tool</child>
<axis><xyz>0 0 1</xyz><limit><lower>0</lower><upper>0.3</upper></limit></axis></joint>
</model></sdf>"""
INERTIA = '<inertia ixx="0.03" iyy="0.02" izz="0.04" ixy="0.001" ixz="0" iyz="0"/>'
# the model's frame is 0.2 m below the foot, which the pose puts at x = 0.1 with z along -y of the world
SAME = f"""<robot name="forms"><link name="world"/>
<link name="base"><inertial><mass value="5"/>{INERTIA}</inertial></link>
<link name="upper"><inertial><origin xyz="0.1 0 0.2" rpy="0.3 0 0"/><mass value="3"/>{INERTIA}
</inertial></link>
<link name="lower"><inertial><origin xyz="0.1 0.1 0" rpy="0 0 0"/><mass value="2"/>{INERTIA}</inertial></link>
<link name="tool"><inertial><mass value="1"/>{INERTIA}</inertial></link>
<joint name="mount" type="fixed"><parent link="world"/><child link="base"/>
<origin xyz="0.1 0.2 0" rpy="{HALF!r} 0 0"/></joint>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="30" velocity="4"/>
<dynamics damping="0.5" friction="0.25"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0 0.4 1" rpy="0 0 {HALF!r}"/><axis xyz="1 0 0"/></joint>
<joint name="slide" type="prismatic"><parent link="lower"/><child link="tool"/><origin xyz="0.1 0 0.4"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.3" effort="1e9" velocity="1e9"/></joint>
</robot>"""


def test_every_form_of_a_pose_as_in_the_urdf_by_hand(tmp_path: Path) -> None:
    (tmp_path / "same.urdf").write_text(SAME)
    urdf, robot = fj.load_robot(tmp_path / "same.urdf").model, load(FORMS, tmp_path).model
    assert list(robot.names) == list(urdf.names)
    for key in ("lowerPositionLimit", "upperPositionLimit", "effortLimit", "velocityLimit", "damping"):
        assert np.asarray(getattr(robot, key)) == pytest.approx(np.asarray(getattr(urdf, key))), key
    assert robot.friction == pytest.approx(urdf.friction)
    rng = np.random.default_rng(11)
    for _ in range(5):
        same_machine(urdf, robot, rng.uniform(-2.0, 2.0, 3), rng.uniform(-3.0, 3.0, 3), EXACT)


# --- small files ------------------------------------------------------------------------------------------
LINK = (
    '<link name="{0}">{1}<inertial><mass>1</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz>'
    "</inertia></inertial></link>"
)
HINGE = (
    '<joint name="{0}" type="revolute">{3}<parent>{1}</parent><child>{2}</child>'
    "<axis><xyz>0 0 1</xyz></axis></joint>"
)


def sdf(inner: str, version: str = "1.9", model: str = "", around: str = "") -> str:
    return f'<sdf version="{version}"><model name="m"{model}>{inner}</model>{around}</sdf>'


TWO = LINK.format("a", "") + LINK.format("b", "<pose>0 0 1 0 0 0</pose>")
ARM = TWO + HINGE.format("j", "a", "b", "")


def load(text: str, tmp_path: Path, **more: object) -> fj.Robot:
    (tmp_path / "m.sdf").write_text(text)
    return fj.load_robot(tmp_path / "m.sdf", **more)  # type: ignore[arg-type]


def test_without_limits_a_joint_turns_freely_and_units_are_as_stated(tmp_path: Path) -> None:
    robot = load(sdf(ARM), tmp_path)
    assert robot.model.upperPositionLimit[0] > 1e8 and robot.joints[0].torque_limit > 1e8
    turned = ARM.replace("<pose>0 0 1 0 0 0</pose>", '<pose degrees="true">0 0 1 90 0 0</pose>')
    place = load(sdf(turned), tmp_path).model.jointPlacements[1]
    assert place.rotation == pytest.approx(pin.rpy.rpyToMatrix(math.pi / 2, 0.0, 0.0), abs=1e-15)


def test_the_place_of_the_model_turns_gravity(tmp_path: Path) -> None:
    """A horizontal axis in the world, by the pose of the model, of its base or of a mount to the world."""
    inner = ARM.replace("<mass>1", "<pose>0.1 0 0 0 0 0</pose><mass>1")
    flat = load(sdf(inner), tmp_path)
    pose = "<pose>0 0 0 1.5707963267948966 0 0</pose>"
    mount = '<joint name="fix" type="fixed"><parent>world</parent><child>a</child></joint>'
    for text in (sdf(pose + inner), sdf(pose + inner + mount)):
        robot = load(text, tmp_path)
        load_of = [
            float(pin.computeGeneralizedGravity(r.model, r.model.createData(), np.zeros(1))[0])
            for r in (flat, robot)
        ]
        assert load_of[0] == pytest.approx(0.0, abs=1e-12) and abs(load_of[1]) == pytest.approx(0.981)


def test_an_axis_in_the_models_frame_as_old_files_have_it(tmp_path: Path) -> None:
    turned = ARM.replace("<pose>0 0 1 0 0 0</pose>", "<pose>0 0 1 1.5707963267948966 0 0</pose>")
    inner = turned.replace("</xyz>", "</xyz><use_parent_model_frame>1</use_parent_model_frame>")
    axes = []
    for text in (sdf(turned, "1.6"), sdf(inner, "1.6"), sdf(turned, "1.4")):  # 1.4 knows no other
        model = load(text, tmp_path).model
        data = model.createData()
        pin.computeJointJacobians(model, data, np.zeros(1))
        axes.append(np.ravel(pin.getJointJacobian(model, data, 1, pin.LOCAL_WORLD_ALIGNED))[3:])
    assert axes[0] == pytest.approx([0, -1, 0], abs=1e-12) and axes[1] == pytest.approx([0, 0, 1], abs=1e-12)
    assert axes[2] == pytest.approx(axes[1], abs=1e-12)


def test_what_is_left_aside_is_said(tmp_path: Path) -> None:
    spring = ARM.replace("</xyz>", "</xyz><dynamics><spring_stiffness>3</spring_stiffness></dynamics>")
    with pytest.warns(RobotWarning, match="joint j: its spring is not read; list a cable_spring"):
        load(sdf(spring), tmp_path)
    floats = ARM.replace('<link name="b">', '<link name="b"><gravity>false</gravity>')
    with pytest.warns(RobotWarning, match="link b has <gravity> switched off in SDF; it weighs here"):
        load(sdf(floats), tmp_path)
    with pytest.warns(RobotWarning, match="link a states no mass or no inertia: SDF takes 1 kg"):
        load(sdf('<link name="a"/>' + ARM.removeprefix(LINK.format("a", ""))), tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (sdf(ARM + "<include><uri>x</uri></include>"), "an <include>; put what it includes into the file"),
        (sdf(ARM + '<model name="n"/>'), "a nested <model>; write its links into the outer one"),
        (sdf(ARM, around='<model name="two"/>'), "expected one <model>, got m, two; leave the others out"),
        ('<sdf version="1.9"><light name="l"/></sdf>', "expected one <model>, got none"),
        (sdf(ARM + "<static>true</static>"), "the model is static"),
        (sdf(""), "the model has no link"),
        (sdf(ARM.replace('"revolute"', '"screw"')), "joint j: type 'screw' is not read, expected one of"),
        (sdf(ARM.replace('"revolute"', '"ball"')), "joint j: type 'ball' is not read"),
        (sdf(ARM + HINGE.format("k", "b", "a", "")), "the joints form a loop"),
        (sdf(ARM + HINGE.format("k", "a", "b", "")), "loops are not modelled; keep one"),
        (
            sdf(ARM + "".join(f'<frame name="f{k}"/>' for k in range(1001))),
            "1001 frames, expected at most 1000",
        ),
        (sdf(TWO), "links a and b hang on no joint; a robot has one root"),
        (sdf(TWO + HINGE.format("j", "world", "b", "")), "joint j moves the model in the world"),
        (sdf(TWO + HINGE.format("j", "a", "c", "")), "unknown frame 'c'; valid: a, b, j"),
        (sdf(TWO + HINGE.format("j", "a", "n::b", "")), "'?n::b'? lies in a nested model"),
        (sdf(ARM.replace("<child>b</child>", "")), "joint j has no <child>; name a link"),
        (sdf(ARM.replace("<mass>1<", "<mass>1,5<")), "link a: mass: expected a number with a decimal point"),
        (sdf(ARM.replace("<mass>1<", "<mass>nan<")), "link a: mass: expected a number"),
        (sdf(ARM.replace("<mass>1<", "<mass>-1<")), "mass -1 kg is negative"),
        (sdf(ARM.replace("0 0 1 0 0 0", "0 0 1 0 0")), "link b: pose: expected 6 numbers"),
        (sdf(ARM.replace("0 0 1</xyz>", "0 0 0</xyz>")), "its axis is zero; give a direction"),
        (sdf(ARM.replace("<axis><xyz>0 0 1</xyz></axis>", "")), "joint j: has no <axis>"),
        (sdf(ARM.replace("<pose>", '<pose relative_to="c">')), "unknown frame 'c'"),
        (sdf(ARM.replace("<pose>", '<pose relative_to="b">')), "are relative to each other"),
        (sdf(ARM + LINK.format("a", "")), "the name a stands twice; rename one"),
        (sdf(ARM, model=' canonical_link="c"'), "canonical_link: unknown link 'c'; valid: a, b"),
        (sdf(ARM, model=' placement_frame="c"'), "unknown frame 'c'"),
        (sdf(ARM.replace("<inertial>", '<inertial auto="true">')), "computed of its shapes"),
        (
            sdf(ARM.replace("<pose>0 0 1 0 0 0<", '<pose rotation_format="quat_xyzw">0 0 1 0 0 0 3<')),
            "a quaternion has the length 1, got 3",
        ),
    ],
)  # fmt: skip
def test_what_is_no_plain_model_is_refused_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=said) as error:
        load(text, tmp_path)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400 and "SDF" in str(error.value)


def test_the_command_refuses_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "m.sdf", tmp_path / "m.yaml"
    path.write_text(sdf(ARM))
    assert main(["init", str(path), "--out", str(out)]) == 0
    assert fj.load_robot(out).joint_names == ("j",)
    capsys.readouterr()
    path.write_text(sdf(ARM + "<include><uri>x</uri></include>"))
    assert main(["init", str(path), "--out", str(out), "--force"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
