"""What the viewer shows, as numbers: meshes, motions, scene, page. test_view_browser.py looks at pictures."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.robots.robot_files import MJCF, URDF, file
from support.thorough import thorough

from flexjoint.cli.main import main
from flexjoint.core.errors import FlexJointError, RobotError, RobotWarning
from flexjoint.core.limits import DESCRIPTION
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.report import view
from flexjoint.report.view import browser, geometry, layers, mesh_files, meshes, motion
from flexjoint.report.view import page as view_page
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import simulate

LIMIT = 8e6  # bytes of a page that can be sent


def wave(name: str, seconds: float, deflection: float = 0.004, label: str = "run") -> view.Motion:
    """Every joint and a floating base sway; motors ahead by the deflection [rad]."""
    loaded = robot.load(name)
    time = np.linspace(0.0, seconds, int(50 * seconds) + 1)
    q = np.tile(motion.on_ground(loaded, loaded.configuration()), (len(time), 1))
    first = 7 if loaded.floating else 0
    q[:, first:] += 0.2 * np.sin(np.outer(time, np.linspace(0.5, 3.0, q.shape[1] - first)))
    links = q[:, [joint.idx_q for joint in loaded.joints]]
    return view.Motion(loaded, label, time, q, links + deflection * np.sin(7.0 * time)[:, None])


def unpacked(page: str) -> tuple[dict[str, Any], bytes]:
    text = re.findall(r'id="scene">([^<]*)<', page)
    whole = gzip.decompress(base64.b64decode(text[0]))
    length = int.from_bytes(whole[:4], "little")
    return json.loads(whole[4 : 4 + length]), whole[4 + length :]


def numbers(place: list[Any], store: bytes) -> np.ndarray:
    kind, offset, count, rows = place
    return np.frombuffer(store, f"<{kind}", count, offset).reshape(rows, -1)


# --- meshes -----------------------------------------------------------------------------------------------
def volume(mesh: meshes.Mesh) -> float:
    """By the divergence theorem: right for a closed surface with one orientation."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(abs(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0)


def test_simple_bodies_have_their_size() -> None:
    # polygons of 28 sides have 0.9916 of a circle's area, a sphere's 12 bands lose about 1.5 % more
    assert volume(meshes.box(np.array([0.2, 0.3, 0.5]))) == pytest.approx(0.03)
    assert volume(meshes.cylinder(0.1, 0.4)) == pytest.approx(np.pi * 0.01 * 0.4 * 0.9916, rel=1e-3)
    assert volume(meshes.cone(0.1, 0.3)) == pytest.approx(np.pi * 0.01 * 0.1 * 0.9916, rel=1e-3)
    assert volume(meshes.sphere(0.1)) == pytest.approx(4.0 / 3.0 * np.pi * 1e-3, rel=0.03)
    capsule = 4.0 / 3.0 * np.pi * 1e-3 + np.pi * 0.01 * 0.4
    assert volume(meshes.sphere(0.1, 0.4)) == pytest.approx(capsule, rel=0.03)
    arrow = meshes.arrow().vertices
    assert arrow[:, 2].min() == 0.0 and arrow[:, 2].max() == 1.0
    assert np.ptp(meshes.sphere(0.1, 0.4).vertices[:, 2]) == pytest.approx(0.6)


def test_a_simplified_mesh_keeps_its_shape() -> None:
    fine = meshes.lathe(np.column_stack([np.sin(x := np.linspace(0, np.pi, 200)), np.cos(x)]), 300)
    coarse = meshes.simplified(fine, 4000)
    assert len(fine.triangles) > 100_000 and 2000 < len(coarse.triangles) <= 4000
    assert volume(coarse) == pytest.approx(volume(fine), rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(coarse.vertices, axis=1), 1.0, atol=0.01)
    assert meshes.simplified(coarse, 4000) is coarse


@pytest.mark.parametrize("name", ["centauro", "ur5", "panda", "talos_arm", "rrbot"])
def test_a_robot_looks_like_its_description(name: str) -> None:
    loaded = robot.load(name)
    shapes = geometry.shapes(loaded, triangles=20_000)
    unique = {id(shape.mesh): len(shape.mesh.triangles) for shape in shapes}
    assert 0 < sum(unique.values()) <= 20_000
    assert {shape.joint for shape in shapes} <= set(range(loaded.model.njoints))
    if name == "centauro":  # four wheels, mirrored on one side, are one mesh
        assert len(shapes) == 45 and len(unique) == 21
        mirrored = [np.linalg.det(shape.placement[:3, :3]) < 0 for shape in shapes]
        assert any(mirrored) and not all(mirrored)


def test_a_section_that_is_left_out_is_not_seen() -> None:
    assert len(geometry.shapes(robot.load("centauro", sections=["legs"]))) == 2 + 4 * 5


def test_a_robot_without_geometry_is_sticks(tmp_path: Path) -> None:
    shapes = geometry.shapes(robot.load(file(tmp_path)))
    balls = [shape for shape in shapes if np.array_equal(shape.placement, np.eye(4))]
    # a ball at each of three joints, sticks of 0.4 and 0.3 m between them, 0.1 m to the hand's end
    assert len(balls) == 3 and len(shapes) == 6
    lengths = sorted(round(float(np.ptp(s.mesh.vertices[:, 2])), 6) for s in shapes if s not in balls)
    assert lengths == [0.1, 0.3, 0.4]


def test_an_mjcf_is_seen(tmp_path: Path) -> None:
    (tmp_path / "arm2.xml").write_text(
        MJCF.format(free="").replace("<inertial", '<geom type="capsule" size="0.05 0.1"/><inertial')
    )
    shapes = geometry.shapes(robot.load(file(tmp_path, urdf=None, mjcf="arm2.xml")))
    assert {shape.joint for shape in shapes} == {1, 2}
    assert np.ptp(shapes[0].mesh.vertices[:, 2]) == pytest.approx(0.3)  # 2 (0.1 + 0.05)


def test_a_mesh_that_is_missing_is_named(tmp_path: Path) -> None:
    path = file(tmp_path)
    urdf = (tmp_path / "arm2.urdf").read_text()
    visual = '<visual><geometry><mesh filename="package://none/hand.stl"/></geometry></visual></link>'
    (tmp_path / "arm2.urdf").write_text(urdf.replace("</link>", visual, 1))
    with pytest.raises(RobotError, match=r"a mesh of .*hand.stl.* add its folder to package_dirs") as error:
        geometry.shapes(robot.load(path))
    assert "\n" not in str(error.value)
    assert geometry.shapes(robot.load(path), "sticks")


# --- motions ------------------------------------------------------------------------------------------------
def test_a_recording_becomes_a_motion() -> None:
    loaded = robot.load("rrbot")
    time = np.linspace(0.0, 1.0, 101)
    q = np.sin(time)
    gap = np.where((time > 0.4) & (time < 0.5), np.nan, q)
    table = {("q", "joint1"): gap, ("theta", "joint1"): q + 0.01, ("theta", "joint2"): 0.5 * q}
    shown = view.from_recording(loaded, recording.make(time, table))
    np.testing.assert_allclose(shown.links[:, 0], q, atol=2e-3)  # a chord of the sine over 0.1 s
    np.testing.assert_array_equal(shown.links[:, 1], 0.5 * q)  # the motor's, where the link was not measured
    assert shown.theta is not None and shown.tau_t is not None
    stiffness = loaded.joint("joint1").drive.K
    np.testing.assert_allclose(shown.tau_t[:, 0], stiffness * (shown.theta - shown.links)[:, 0])
    torque = {**table, ("tau_t", "joint1"): 3.0 * q}
    measured = view.from_recording(loaded, recording.make(time, torque)).tau_t
    assert measured is not None
    np.testing.assert_array_equal(measured[:, 0], 3.0 * q)


def test_a_floating_robot_stands_on_its_contacts() -> None:
    loaded = robot.load("centauro")
    for pose in loaded.poses:
        shown = view.posed(loaded, pose)
        points = motion.contact_points(loaded, shown.q)
        assert points.shape == (1, 4, 3) and np.abs(points[..., 2]).max() < 2e-6  # the pose's own digits
    time = np.linspace(0.0, 1.0, 60)
    table = recording.make(time, {("q", "j_arm1_4"): np.full(60, -2.0)})
    shown = view.from_recording(loaded, table)
    assert shown.q[0, 2] == pytest.approx(0.8108, abs=1e-4)  # the height of the initial pose
    base = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], (60, 1))
    np.testing.assert_array_equal(view.from_recording(loaded, table, base=base).q[:, :7], base)


def test_a_simulation_shows_its_true_motion() -> None:
    loaded = robot.load("rrbot_last_joint")
    time = np.linspace(0.0, 0.5, 101)
    run = simulate(
        FlexibleJointModel(loaded), recording.make(time, {("q_ref", "joint2"): 0.3 * np.sin(5 * time)})
    )
    shown = view.from_simulation(loaded, run, "nominal")
    np.testing.assert_allclose(shown.links[:, 0], run.true.get("q", "joint2"), atol=1e-12)
    assert shown.theta is not None
    np.testing.assert_allclose(shown.theta[:, 0], run.true.get("theta", "joint2"), atol=1e-12)


def test_a_base_turns_the_short_way_between_samples() -> None:
    loaded = robot.load("centauro")
    q = np.tile(loaded.configuration(), (2, 1))
    q[1, 3:7] = [0.0, 0.0, -np.sin(0.5), -np.cos(0.5)]  # 1 rad about z, with the quaternion's other sign
    half = view.Motion(loaded, "turn", np.array([0.0, 1.0]), q).at(np.array([0.5])).q[0]
    expected = np.array([0.0, 0.0, np.sin(0.25), np.cos(0.25)])
    np.testing.assert_allclose(half[3:7] * np.sign(half[6]), expected, atol=1e-12)


def test_wrong_motions_are_refused() -> None:
    arm = view.still(robot.load("ur5"))
    with pytest.raises(FlexJointError, match=r"points and forces of shape \(1, c, 3\), got \(2, 4, 3\)"):
        arm.with_contacts(np.zeros((2, 4, 3)), np.zeros((2, 4, 3)))
    with pytest.raises(FlexJointError, match="nothing to show"):
        view.show([])
    with pytest.raises(FlexJointError, match=r"q: expected \(6,\) positions of ur5, got \(5,\)"):
        view.still(robot.load("ur5"), np.zeros(5))
    zeros, q = np.zeros(1), np.zeros((1, 6))
    for wrong, said in (
        (view.Motion(arm.robot, "x", zeros, q * np.nan), "x: q is not finite everywhere"),
        (
            view.Motion(arm.robot, "x", zeros, q, q[:, :5]),
            r"x: expected theta of shape \(1, 6\), got \(1, 5\)",
        ),
        (view.Motion(arm.robot, "x", np.zeros(2), np.zeros((2, 6))), "x: its times do not increase strictly"),
    ):
        with pytest.raises(FlexJointError, match=said):
            view.show(wrong)
    table = recording.make(np.linspace(0, 1, 60), {("q", "knee"): np.zeros(60)})
    with pytest.raises(FlexJointError, match="no q or theta of any joint of ur5; its joints are shoul"):
        view.from_recording(arm.robot, table)
    there = recording.make(np.linspace(0, 1, 60), {("q", "elbow_joint"): np.zeros(60)})
    with pytest.raises(FlexJointError, match=r"base: expected none, for ur5 is fixed, got shape .60, 7."):
        view.from_recording(arm.robot, there, base=np.zeros((60, 7)))


# --- scene ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("deflection", "factor"), [(0.3, 1.0), (0.08, 1.0), (0.06, 2.0), (0.02, 5.0), (0.004, 20.0), (0.0, 1.0)]
)
def test_deflections_are_made_visible_by_a_round_factor(deflection: float, factor: float) -> None:
    loaded = robot.load("rrbot")
    theta = np.array([[0.0, deflection]])
    shown = view.Motion(loaded, "x", np.zeros(1), np.zeros((1, 2)), theta)
    assert layers._exaggeration([shown]) == factor
    notes = layers.build([shown], layers.Looks()).notes
    assert bool(notes) == (factor != 1.0) and all(f"{factor:g} times" in note for note in notes)


def test_nodes_are_where_pinocchio_puts_them() -> None:
    shown = wave("centauro", 1.0)
    header, store = unpacked(view.show(shown, exaggerate=10.0).html())
    model = shown.robot.model
    data = model.createData()
    nodes = {node["name"]: node for node in header["nodes"]}
    frame, row = 17, 34  # 25 frames per second of 50 samples per second
    assert numbers(header["times"], store)[frame, 0] == pytest.approx(shown.time[row])
    theta = shown.q[row].copy()
    for k, joint in enumerate(shown.robot.joints):
        assert shown.theta is not None
        theta[joint.idx_q] += 10.0 * (shown.theta[row, k] - theta[joint.idx_q])
    for name, q in (("q", shown.q[row]), ("theta", theta)):
        pin.forwardKinematics(model, data, q)
        for joint in (model.getJointId("ankle_yaw_2"), model.getJointId("j_arm1_6")):
            pose = numbers(nodes[f"{name}/{joint}"]["poses"], store)[frame]
            # 16 bits of mantissa: 1.5e-5 of values up to 1
            np.testing.assert_allclose(pose, pin.SE3ToXYZQUAT(data.oMi[joint]), atol=2e-5)
    values = numbers(nodes["spring/knee_pitch_1"]["values"], store)[frame, 0]
    assert values == pytest.approx(4.0 * np.sin(7.0 * shown.time[row]), abs=1e-3)  # mrad
    assert "spring/velodyne_joint" not in nodes  # rigid
    assert header["legend"]["unit"] == "mrad"


def test_springs_lie_along_their_axes() -> None:
    loaded = robot.load("rrbot")
    np.testing.assert_allclose(layers._axis(loaded, 1), [0, 1, 0], atol=1e-12)
    turned = geometry.along(np.array([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(turned @ [0, 0, 1], [0, 0.6, 0.8], atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)


def test_the_support_polygon_is_the_hull() -> None:
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.5, 0], [np.nan, 3]], dtype=float)
    assert {tuple(p) for p in layers._hull(points)} == {(0, 0), (1, 0), (1, 1), (0, 1)}
    assert len(layers._hull(points[:1])) == 1 and len(layers._hull(points[:2])) == 2


@thorough
def test_robots_side_by_side_do_not_touch() -> None:
    drawn = [wave("ur5", 1.0, label=label) for label in ("measured", "nominal", "extended")]
    scene = layers.build(drawn, layers.Looks(triangles=5000))
    places = [actor.place[1] for actor in scene.actors]
    one = layers.build(drawn[:1], layers.Looks(triangles=5000)).extent
    assert np.all(np.diff(places) > np.ptp(one[:, 1]))
    assert [actor.label for actor in scene.actors] == ["measured", "nominal", "extended"]


# --- page -----------------------------------------------------------------------------------------------
@thorough
def test_centauro_three_times_is_light_enough_to_send() -> None:
    page = view.show(
        [wave("centauro", 60.0, d, label) for d, label in ((0.004, "a"), (0.005, "b"), (0.006, "c"))]
    )
    assert len(page.html()) < LIMIT
    assert page.rate < 25.0  # for which frames were left out, evenly, over the whole minute
    assert page.scene.times[-1] == 60.0


def test_the_page_holds_all_it_needs() -> None:
    page = view.show(view.posed(robot.load("centauro"), "mammal")).html()
    assert len(page) < 3e6
    outside = re.findall(r"""(?:src|href)=["']?(?!data:)([^"'>\s]+)""", page.split("<script>")[0])
    assert outside == []
    assert page.count("<script src") == 0 and "Permission is hereby granted" in page  # MeshCat's licence
    assert page == view.show(view.posed(robot.load("centauro"), "mammal")).html()  # same bytes


def test_the_example_of_the_docs_runs() -> None:
    text = (Path(__file__).parents[2] / "docs" / "howto" / "viewing.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(text.split("```python\n")[2].split("```")[0], names)
    scene = names["page"].scene
    assert {layer.name for layer in scene.layers} == {"robot", "forces", "mass", "support"}
    assert scene.notes == ("longest arrow: 287 N",)


def test_titles_are_escaped() -> None:
    arm = view.still(robot.load("rrbot"), label="</script><b>x")
    page = view.show(arm, title='<i>"&').html()
    assert "<title>&lt;i&gt;&quot;&amp;</title>" in page and "</script><b>x" not in page


# --- command line -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--pose", "sitting"], "unknown pose 'sitting'; valid: initial"),
        (["--colour", "red"], "colour: expected deflection or torque, got 'red'"),
        (["--geometry", "mesh"], "geometry: expected visual or collision or sticks, got 'mesh'"),
        (["--triangles", "3"], "triangles: expected at least 1000, got 3"),
        (["--rate", "0"], "rate: expected a number above 0, got 0"),
        (["--exaggerate", "nan"], "exaggerate: expected a number above 0, got nan"),
        (["--size", "wide"], "--size: expected WIDTHxHEIGHT of 64 to 8192 px, e.g. 1280x800; got 'wide'"),
        (["--labels", "a,b"], "--labels: expected 1 of them, got 2"),
        (["--nominal"], "--nominal and --extended need a recording to simulate"),
        (["none.csv"], "recording none.csv does not exist"),
        (["--html", "arm.txt"], "expected a name that ends in .html or .htm, got .txt"),
        (["--images", __file__], "it is a file; give a folder"),
    ],
)
def test_a_wrong_option_is_one_line(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [] if "--html" in options else ["--html", str(tmp_path / "arm.html")]
    assert main(["view", "--robot", "rrbot", *where, *options]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error and "\n" not in error
    assert not (tmp_path / "arm.html").exists()


def test_the_command_shows_a_recording_beside_its_simulations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loaded = robot.load("rrbot_last_joint", preset="K500")
    time = np.linspace(0.0, 1.0, 501)
    run = simulate(
        FlexibleJointModel(loaded), recording.make(time, {("q_ref", "joint2"): 0.3 * np.sin(5 * time)})
    )
    recording.write(run.measured, tmp_path / "monday.parquet")
    robot.write(loaded, tmp_path / "extended.yaml")
    out = tmp_path / "new" / "view.html"
    options = ["--nominal", "--extended", str(tmp_path / "extended.yaml"), "--colour", "torque"]
    table = str(tmp_path / "monday.parquet")
    assert main(["view", table, "--robot", "rrbot_last_joint", *options, "--html", str(out)]) == 0
    assert "MB, opens offline" in capsys.readouterr().out
    header, _ = unpacked(out.read_text())
    assert [actor["label"] for actor in header["actors"]] == ["monday", "nominal", "extended"]
    assert header["legend"]["label"] == "spring torque"


def test_without_a_browser_pictures_are_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(browser.NoBrowserError):
        browser.find()
    assert main(["view", "--robot", "rrbot", "--images", str(tmp_path / "pictures")]) == 2
    assert "no browser found, looked for chromium" in capsys.readouterr().err


# --- meshes that lie ------------------------------------------------------------------------------------
def with_mesh(folder: Path, name: str, content: bytes = b"", looks: str = "") -> Robot:
    """The arm with a mesh, or another geometry, as the looks of its first link."""
    (folder / Path(name).name).write_bytes(content)
    shape = looks or f'<mesh filename="{name}"/>'
    link = f'<link name="upper"><visual><geometry>{shape}</geometry></visual>'
    path = file(folder, lock=["wrist"])
    (folder / "arm2.urdf").write_text(URDF.replace('<link name="upper">', link))
    return robot.load(path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("m.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "m.obj holds numbers that are not finite"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 99\n", r"cannot be read: .*vertex index out of range"),
        ("m.stl", b"x" * 80 + b"\xff\xff\xff\xff", r"a mesh of .* cannot be read"),
        ("m.stl", b"", "File is empty"),
        ("package://../../m.stl", b"", r"mesh package://\.\./\.\./m\.stl leaves its package"),
    ],
)
def test_a_mesh_that_lies_is_refused(
    tmp_path: Path, name: str, content: bytes, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    loaded = with_mesh(tmp_path, name, content)
    with pytest.raises(RobotError, match=said):
        geometry.shapes(loaded)
    assert "Error" not in capfd.readouterr().err


OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
COLLADA = b'<mesh><%b count="1"><input offset="0"/><input offset="1"/>%b</%b></mesh>'


@pytest.mark.parametrize(
    ("name", "content", "count"),
    [
        ("m.stl", b"\0" * 80 + b"\3\0\0\0" + b"\0" * 150, 3),
        ("m.stl", b"\0" * 80 + b"\1\0\0\0" + b"\0" * 150, 3),  # it states fewer than there are
        ("m.STL", b"solid\n" + 2 * b"facet\nouter loop\nvertex 0 0 0\nendloop\nendfacet\n", 2),
        ("m.obj", OBJ + b"f 1 2 3\n f 1/1 2/2 3/3 4/4\nfoo 1 2 3 4\n", 3),
        ("m.dae", COLLADA % (b"triangles", b"<p>0 0 1 1 2 2\n0 0 1 1 2 2 </p>", b"triangles"), 2),
        ("m.dae", COLLADA % (b"polylist", b"<vcount>4 3</vcount><p>%b</p>" % (b"0 0 " * 7), b"polylist"), 3),
        ("m.dae", COLLADA % (b"polygons", 2 * (b"<p>%b</p>" % (b"0 0 " * 5)), b"polygons"), 6),
        ("m.ply", b"\0" * 120, 10),
    ],
)
def test_triangles_are_counted_before_a_mesh_is_read(
    tmp_path: Path, name: str, content: bytes, count: int
) -> None:
    (tmp_path / name).write_bytes(content)
    assert mesh_files.triangles_in(tmp_path / name, 1) == count
    assert mesh_files.triangles_in(tmp_path / name, 10_000) == 0  # so many do not fit in


def test_a_mesh_of_too_many_triangles_is_refused_before_it_is_read(tmp_path: Path) -> None:
    content = OBJ + b"f 1 2 3\n" * (DESCRIPTION.mesh_triangles + 1)
    loaded = with_mesh(tmp_path, "m.obj", content)
    with pytest.raises(RobotError, match=r"mesh m.obj has more than 400000 triangles, .*make it coarser"):
        geometry.shapes(loaded)


def test_of_triangles_that_collapse_to_one_the_first_is_kept() -> None:
    rows = np.sort(np.random.default_rng(1).integers(0, 12, (5000, 3)), axis=1)
    body = meshes.Mesh(np.random.default_rng(2).normal(size=(12, 3)), rows)
    coarse = meshes.simplified(body, 4)
    assert len(np.unique(np.sort(coarse.triangles, axis=1), axis=0)) == len(coarse.triangles)


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_a_mesh_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path, kind: str) -> None:
    (tmp_path / "meshes").mkdir()
    with (tmp_path / "meshes" / "m.stl").open("wb") as file:
        file.truncate(DESCRIPTION.mesh_bytes + 1)  # of zeros, which are no mesh
    if kind == "urdf":
        loaded = with_mesh(tmp_path, "package://meshes/m.stl")
    else:
        mesh = '<compiler meshdir="meshes"/><asset><mesh name="m" file="m.stl"/></asset><worldbody>'
        (tmp_path / "arm2.xml").write_text(MJCF.format(free="").replace("<worldbody>", mesh))
        loaded = robot.load(tmp_path / "arm2.xml")
    with pytest.raises(RobotError, match=r"m\.stl has more than 30000000 bytes"):
        geometry.shapes(loaded)


def test_a_geometry_that_is_not_shown_is_named(tmp_path: Path) -> None:
    loaded = with_mesh(tmp_path, "m", looks="<sphere/>")
    with pytest.warns(
        RobotWarning, match="not all of its geometry is shown: Sphere shape must have a radius"
    ):
        geometry.shapes(loaded)


def test_without_meshcat_it_is_said_before_the_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    usual = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "meshcat" else usual(name))
    view_page.meshcat_viewer.cache_clear()
    assert main(["view", "not_there.csv", "--robot", "kr300"]) == 2
    said = capsys.readouterr().err
    assert said == "flexjoint: meshcat is not installed; install it with: pip install 'flexjoint[report]'\n"
