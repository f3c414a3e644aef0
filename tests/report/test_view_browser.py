"""The viewer in a real headless browser: the page loads, the robot is in the picture, the animation plays."""

from __future__ import annotations

import html as markup
import stat
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from support.browsers import changed, near, need_browser, pixels
from support.thorough import thorough

from flexjoint.cli.main import main
from flexjoint.report import view
from flexjoint.report.view.browser import Browser, opened
from flexjoint.report.view.motion import contact_points
from flexjoint.robot import robot

SIZE = (480, 320)  # software draws it, on two cores


@pytest.fixture(scope="module", autouse=True)
def browser_there() -> None:
    need_browser()


def arm_motion(turn: float = 1.2) -> view.Motion:
    """A UR5 that lifts its elbow, its motors 0.02 rad ahead at the elbow."""
    loaded = robot.load("ur5")
    q = np.tile(loaded.configuration(), (26, 1))
    elbow = loaded.joint("elbow_joint").idx_q
    q[:, elbow] -= np.linspace(0.0, turn, 26)
    theta = q.copy()
    theta[:, elbow] += 0.02
    return view.Motion(loaded, "arm", np.linspace(0.0, 1.0, 26), q, theta)


@pytest.fixture(scope="module")
def arm() -> Iterator[Browser]:
    with opened(view.show(arm_motion(), triangles=20_000).html(), SIZE) as browser:
        yield browser


@pytest.fixture(scope="module")
def standing() -> Iterator[Browser]:
    """CENTAURO on its wheels, three of which carry it."""
    loaded = robot.load("centauro")
    still = view.posed(loaded, "spider")
    points = contact_points(loaded, still.q)
    forces = np.zeros_like(points)
    forces[:, 1:, 2] = 380.0
    with opened(view.show(still.with_contacts(points, forces)).html(), SIZE) as browser:
        yield browser


def shown(browser: Browser, *layers: str) -> np.ndarray:
    """The picture with these layers alone, without what is written over it."""
    browser.evaluate(  # at once, so that it is drawn once
        "for (const id of ['head', 'player', 'labels']) document.getElementById(id).style.opacity = 0;"
        f"for (const l of Object.keys(flexjoint.layers)) flexjoint.toggle(l, {list(layers)}.includes(l));"
        "flexjoint.draw()"
    )
    return pixels(browser.picture())


def test_centauro_loads_from_one_file_without_a_complaint(standing: Browser) -> None:
    assert standing.said.errors == []
    assert [url.split(":")[0] for url in standing.said.requests] == ["file"]  # the page itself, and no more
    assert standing.evaluate("document.querySelector('#head h1').textContent") == "centauro: spider"
    assert standing.evaluate("performance.getEntriesByType('resource').length") == 0


def test_centauro_is_in_the_picture(standing: Browser) -> None:
    robot_there = shown(standing, "robot")
    body = changed(shown(standing), robot_there)
    rows, columns = np.nonzero(body)
    height, width = body.shape
    assert 0.08 < body.mean() < 0.5  # a robot that fills the frame, not a speck and not a wall
    assert rows.min() > 0 and rows.max() < height - 1 and columns.min() > 0 and columns.max() < width - 1
    assert rows.max() - rows.min() > 0.5 * height
    dark = robot_there[body].max(axis=1) < 110
    assert dark.mean() > 0.3  # most of its covers are dark grey
    # and its light brown shanks: red over green over blue
    r, g, b = robot_there[body].T
    assert np.mean((r > g + 15) & (g > b + 15)) > 0.08


def test_forces_centre_of_mass_and_support_are_seen(standing: Browser) -> None:
    assert near(shown(standing, "forces"), (217, 26, 31)) > 150
    assert near(shown(standing, "mass"), (26, 89, 217)) > 30
    edges = "flexjoint.nodes.filter(n => n.layer === 'support' && n.group.scale.z > 0.01).length"
    assert standing.evaluate(edges) == 3  # one wheel carries nothing
    assert near(shown(standing, "support"), (26, 158, 89)) > 80
    assert standing.evaluate("document.getElementById('notes').textContent") == "longest arrow: 380 N"


def test_the_animation_moves_the_robot_and_nothing_else(arm: Browser) -> None:
    arm.evaluate("flexjoint.pause()")
    pictures = {}
    for frame in (0, 25):
        arm.evaluate(f"flexjoint.show({frame})")
        pictures[frame] = shown(arm, "robot"), shown(arm)
    body = {frame: changed(empty, full) for frame, (full, empty) in pictures.items()}
    moved = changed(pictures[0][0], pictures[25][0])
    assert moved.mean() > 0.01
    # what is not robot before or after does not change, but for the shadow's soft edge
    assert np.count_nonzero(moved & ~body[0] & ~body[25]) < 0.25 * np.count_nonzero(moved)
    # the column below the shoulder stands still
    rows, columns = np.nonzero(body[0] & body[25])
    foot = rows.max()
    still = (rows > foot - 20) & ~moved[rows, columns]
    assert np.count_nonzero(still) > 60
    assert arm.evaluate("flexjoint.viewer.scene_tree !== undefined")  # it is MeshCat's viewer


def test_it_plays_by_itself_and_stops_at_the_end(arm: Browser) -> None:
    arm.evaluate("flexjoint.pause(); flexjoint.show(0); flexjoint.play()")
    end = time.monotonic() + 30.0  # a machine that draws one picture a second gets there
    frames = []
    while time.monotonic() < end and (not frames or frames[-1] < 25):
        frames.append(arm.evaluate("flexjoint.frame"))
        time.sleep(0.05)
    assert frames[-1] == 25 and frames == sorted(frames)
    time.sleep(0.1)
    assert arm.evaluate("flexjoint.playing") is False


def test_slider_and_button_are_the_readers(arm: Browser) -> None:
    arm.evaluate(
        "const s = document.getElementById('slider'); s.value = 13; s.dispatchEvent(new Event('input'))"
    )
    assert arm.evaluate("flexjoint.frame") == 13
    assert arm.evaluate("document.getElementById('clock').textContent") == "0.52 / 1.00 s"
    arm.evaluate("document.getElementById('play').click()")
    assert arm.evaluate("flexjoint.playing") is True
    arm.evaluate("document.getElementById('play').click()")
    assert arm.evaluate("flexjoint.playing") is False
    boxes = "[...document.querySelectorAll('#layers label')].map(l => l.textContent)"
    # 0.02 rad is drawn as 0.1, the largest of 1, 2, 5 times a power of ten below 0.15
    assert arm.evaluate(boxes) == [
        "robot, at q", "motor side, at theta (deflection ×5)", "springs, by deflection", "centre of mass",
    ]  # fmt: skip


def test_springs_have_the_colour_of_their_deflection(arm: Browser) -> None:
    arm.evaluate("flexjoint.pause(); flexjoint.show(3)")
    colours = arm.evaluate(
        "flexjoint.nodes.filter(n => n.layer === 'springs')"
        ".map(n => n.group.children[0].material.color.toArray())"
    )
    names = robot.load("ur5").joint_names
    elbow = dict(zip(names, colours, strict=True))
    # the only deflected one has the legend's end, the others its middle (player.js: HOT, MIDDLE)
    np.testing.assert_allclose(elbow.pop("elbow_joint"), (0.82, 0.1, 0.13), atol=1e-3)
    np.testing.assert_allclose(list(elbow.values()), np.tile((0.93, 0.93, 0.9), (5, 1)), atol=1e-3)
    assert near(shown(arm, "springs"), (209, 26, 33)) > 15
    ends = "[...document.querySelectorAll('#legend .ends span')].map(s => s.textContent)"
    assert arm.evaluate(ends) == ["-20", "spring deflection [mrad]", "+20"]


def test_the_spring_under_the_mouse_tells_its_joint(arm: Browser) -> None:
    arm.evaluate("flexjoint.pause(); flexjoint.show(3); flexjoint.toggle('springs', true); flexjoint.draw()")
    # a vertex of the elbow's coil, where the screen has it
    x, y = arm.evaluate(
        "(() => { const n = flexjoint.nodes.find(n => n.name === 'spring/elbow_joint');"
        " const m = n.group.children[0]; m.updateWorldMatrix(true, false);"
        " const v = new MeshCat.THREE.Vector3().fromBufferAttribute(m.geometry.attributes.position, 210);"
        " v.applyMatrix4(m.matrixWorld).project(flexjoint.viewer.camera);"
        " return [(0.5 + 0.5 * v.x) * innerWidth, (0.5 - 0.5 * v.y) * innerHeight]; })()"
    )
    tip = "document.getElementById('tip')"
    arm.evaluate(f"flexjoint.point({x}, {y}, false)")
    assert arm.evaluate(f"{tip}.textContent") == "elbow_joint: 20.0 mrad"
    assert arm.evaluate(f"{tip}.style.display") == "block"
    arm.evaluate("flexjoint.point(2, 2, false)")
    assert arm.evaluate(f"{tip}.style.display") == "none"


@thorough
def test_robots_side_by_side_have_their_labels_above_them() -> None:
    measured = arm_motion()
    name = "nominal_with_a_name_that_is_very_long_and_has_no_spaces_in_it_anywhere"
    motions = [replace(measured, label=label) for label in ("measured", name, "extended")]
    with opened(view.show(motions, triangles=4000).html(), (800, 480)) as browser:
        boxes = browser.evaluate(
            "[...document.querySelectorAll('#labels div')].map(d => { const b = d.getBoundingClientRect();"
            " return [d.textContent, b.left, b.right, b.top, b.bottom]; })"
        )
        assert [box[0] for box in boxes] == ["measured", name, "extended"]
        ends = [x for _, left, right, _, _ in boxes for x in (left, right)]
        assert ends == sorted(ends) and ends[0] >= 0 and ends[-1] <= 800
        body = changed(shown(browser), shown(browser, "robot"))
        pieces, count = ndimage.label(body, np.ones((3, 3)))
        robots = [k for k in range(1, count + 1) if np.count_nonzero(pieces == k) > 800]
        assert len(robots) == 3  # apart from each other
        found = sorted((np.nonzero(pieces == k) for k in robots), key=lambda where: where[1].mean())
        for (rows, columns), (_, left, right, _, bottom) in zip(found, boxes, strict=True):
            assert columns.min() < 0.5 * (left + right) < columns.max() and bottom <= rows.min() + 2
        assert browser.said.errors == []


@thorough
def test_a_notebook_shows_it_in_a_frame() -> None:
    cell = view.show(arm_motion(), triangles=4000)._repr_html_()
    assert cell.startswith("<iframe srcdoc=") and markup.unescape(cell).count("MeshCat.Viewer") >= 1
    page = f"<html><body><h1></h1>{cell}<script>window.flexjoint = 'outer'</script></body></html>"
    with opened(page, SIZE) as browser:
        inner = "document.querySelector('iframe').contentWindow"
        end = time.monotonic() + 60.0
        while not browser.evaluate(f"Boolean({inner}.flexjoint || {inner}.flexjointFailed)"):
            assert time.monotonic() < end
            time.sleep(0.1)
        assert browser.evaluate(f"{inner}.flexjoint.times.length") == 26
        assert browser.said.errors == []


def test_a_broken_page_says_so() -> None:
    page = view.show(arm_motion(), triangles=4000).html()
    with pytest.raises(ValueError, match="the page failed"), opened(page.replace("H4sI", "H4sX", 1), SIZE):
        pass


# --- pictures and video -----------------------------------------------------------------------------------
def test_the_command_writes_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "pictures"
    assert main(["view", "--robot", "rrbot", "--images", str(folder), "--size", "320x240"]) == 0
    (image,) = folder.iterdir()
    assert image.name == "frame_00000.png" and pixels(image.read_bytes()).shape == (240, 320, 3)
    assert "wrote 1 images" in capsys.readouterr().out


@thorough
def test_pictures_tell_how_far_they_are(tmp_path: Path) -> None:
    page, told = view.show(arm_motion(), triangles=4000), []
    made = page.write_images(tmp_path, (160, 120), every=10, progress=lambda share, _what: told.append(share))
    assert told == [k / len(made) for k in range(len(made))] and len(made) > 2


@thorough
def test_a_video_is_made_of_all_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ffmpeg itself is replaced by a script that notes what it is given."""
    encoder = tmp_path / "bin" / "ffmpeg"
    encoder.parent.mkdir()
    encoder.write_text(
        '#!/bin/sh\necho "$@" > "$(dirname "$0")/said"\nfor last; do :; done\n'
        'folder=$(dirname "$(echo "$@" | sed "s/.*-i \\([^ ]*\\) .*/\\1/")")\n'
        'ls "$folder" > "$last"\n'
    )
    encoder.chmod(encoder.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", str(encoder.parent), prepend=":")
    page = view.show(arm_motion(), triangles=4000)
    out = page.write_video(tmp_path / "arm.mp4", (321, 241), every=5)
    assert out.read_text().split() == [f"frame_{k:05d}.png" for k in range(6)]
    assert "-framerate 5 " in (encoder.parent / "said").read_text()
