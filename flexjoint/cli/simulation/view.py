"""`flexjoint view`: a robot, or recordings and simulations of it side by side; a page, pictures, video."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexjoint.cli import options
from flexjoint.core.errors import FlexJointError
from flexjoint.core.messages import escaped

if TYPE_CHECKING:
    from flexjoint.recording.table import Recording
    from flexjoint.report.view import Motion, Page
    from flexjoint.robot.robot import Robot

TABLES = (".csv", ".parquet")


def add(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command to the parser's commands."""
    parser = commands.add_parser("view", help="see a robot, recordings and simulations move")
    parser.add_argument(
        "recordings", nargs="*", type=Path, metavar="REC", help="tables to play side by side; none: a pose"
    )
    options.add_robot(parser)
    parser.add_argument("--pose", default="initial", metavar="NAME", help="a pose of the robot file")
    parser.add_argument(
        "--nominal", action="store_true", help="beside the first table, the robot's simulation of it"
    )
    parser.add_argument(
        "--extended", metavar="EXT.yaml", help="and that of an extended robot, as diagnose --model writes it"
    )
    parser.add_argument("--horizon", type=float, default=0.5, help="of those simulations [s], as in compare")
    options.add_engine(parser)
    parser.add_argument("--labels", metavar="A,B,...", help="what stands above the robots")
    parser.add_argument("--html", type=Path, metavar="OUT.html", help="write a page that opens offline")
    parser.add_argument("--images", type=Path, metavar="FOLDER", help="write PNGs (needs Chromium)")
    parser.add_argument("--video", type=Path, metavar="OUT.mp4", help="write a video (Chromium and ffmpeg)")
    parser.add_argument("--rate", type=float, default=25.0, help="frames per second, default 25")
    parser.add_argument(
        "--size", default="1280x800", metavar="WxH", help="of pictures [px], default 1280x800"
    )
    parser.add_argument(
        "--colour", default="deflection", metavar="deflection|torque", help="what colours the springs"
    )
    parser.add_argument(
        "--exaggerate", type=float, help="factor on deflections of the motor side (default: until seen)"
    )
    parser.add_argument(
        "--geometry", default="visual", metavar="visual|collision|sticks", help="meshes, default visual"
    )
    parser.add_argument("--triangles", type=int, default=100_000, help="of all meshes, default 100000")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Do what the arguments ask for."""
    from flexjoint.cli import outputs as cli_outputs
    from flexjoint.report.progress import Progress
    from flexjoint.report.view.page import meshcat_viewer

    size = _size(arguments.size)
    for path, suffixes in ((arguments.html, (".html", ".htm")), (arguments.video, (".mp4", ".webm", ".mkv"))):
        if path is not None:
            cli_outputs.check_place(path, suffixes, [Path(arguments.robot), *arguments.recordings])
    if arguments.images is not None and arguments.images.exists() and not arguments.images.is_dir():
        raise FlexJointError(f"cannot write images into {arguments.images}: it is a file; give a folder")
    meshcat_viewer()  # complains before the work, not after it
    if arguments.images is not None or arguments.video is not None:
        from flexjoint.report.view import browser

        browser.find()
        if arguments.video is not None:
            browser.find_encoder()
    page = _page(arguments, options.load_chosen(arguments, actuated=False))
    if arguments.html is not None:
        page.write_html(arguments.html)
        megabytes = arguments.html.stat().st_size / 1e6
        print(f"wrote {escaped(str(arguments.html))}: {megabytes:.1f} MB, opens offline")
    if arguments.images is not None:
        with Progress() as bar:
            made = page.write_images(arguments.images, size, progress=bar)
        print(f"wrote {len(made)} images: {escaped(str(made[0]))} to {escaped(made[-1].name)}")
    if arguments.video is not None:
        with Progress() as bar:
            video = page.write_video(arguments.video, size, progress=bar)
        print(f"wrote {escaped(str(video))}: {len(page.frames())} frames")
    if arguments.html is None and arguments.images is None and arguments.video is None:
        _show(page)


def _page(arguments: argparse.Namespace, robot: Robot) -> Page:
    from flexjoint.report import view

    return view.show(
        _labelled(_motions(arguments, robot), arguments.labels),
        arguments.rate,
        arguments.colour,
        arguments.exaggerate,
        arguments.geometry,
        arguments.triangles,
    )


def _motions(arguments: argparse.Namespace, robot: Robot) -> list[Motion]:
    from flexjoint.recording import table as recording
    from flexjoint.recording.checks import check
    from flexjoint.report import view
    from flexjoint.robot.robot import load

    compared = arguments.nominal or arguments.extended is not None
    if not arguments.recordings:
        if compared:
            raise FlexJointError("--nominal and --extended need a recording to simulate; give a table")
        return [view.posed(robot, arguments.pose)]
    tables = [recording.read(path) for path in arguments.recordings]
    motions = [
        view.from_recording(robot, table, path.stem)
        for table, path in zip(tables, arguments.recordings, strict=True)
    ]
    if compared:
        check(robot, tables[0])
        motions.insert(1, _simulated(robot, tables[0], arguments, "nominal"))
    if arguments.extended is not None:
        motions.insert(2, _simulated(load(arguments.extended), tables[0], arguments, "extended"))
    return motions


def _simulated(robot: Robot, table: Recording, arguments: argparse.Namespace, label: str) -> Motion:
    """A robot's simulation of a recording, in windows from the measured state."""
    from flexjoint.diagnosis.comparison.compare import compare
    from flexjoint.recording.table import make
    from flexjoint.report import view
    from flexjoint.report.progress import Progress

    with Progress() as bar:
        result = compare(robot, table, horizon=arguments.horizon, engine=arguments.engine, progress=bar)
    return view.from_recording(robot, make(result.time, result.simulated, label), label)


def _labelled(motions: list[Motion], labels: str | None) -> list[Motion]:
    from dataclasses import replace

    if labels is None:
        return motions
    names = [name.strip() for name in labels.split(",")]
    if len(names) != len(motions):
        raise FlexJointError(f"--labels: expected {len(motions)} of them, got {len(names)}")
    return [replace(motion, label=name) for motion, name in zip(motions, names, strict=True)]


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.partition("x")
    if not (x and width.isdecimal() and height.isdecimal() and 64 <= int(width) <= 8192 >= int(height) >= 64):
        raise FlexJointError(f"--size: expected WIDTHxHEIGHT of 64 to 8192 px, e.g. 1280x800; got {text!r}")
    return int(width), int(height)


def _show(page: Page) -> None:
    import tempfile
    import webbrowser

    path = Path(tempfile.mkdtemp(prefix="flexjoint-")) / "view.html"
    page.write_html(path)
    opened = webbrowser.open(path.as_uri())
    print(f"{'opened' if opened else 'no browser to open it in; wrote'} {path}")
