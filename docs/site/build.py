"""The documentation as a site: lays its sources together and runs Sphinx on them (`make site`).

    python docs/site/build.py OUT [--report REPORT.html]

Pages stay where they are in the repository, so that links lead to the same places there and on the site; what
is generated (API, command line, gallery, landing page) is written beside copies of them. Every warning is an
error, so that a link that leads nowhere ends the build.
"""

from __future__ import annotations

import argparse
import inspect
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGES = (
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/start/*.md",
    "docs/howto/*.md",
    "docs/reference/*.md",
    "docs/explained/*.md",
    "docs/studies/*.md",
    "docs/pictures/*",
    "robots/*/README.md",
    "notebooks/**/*",
)
LINKED = (  # files that pages link to, and that are no pages
    "LICENSE", "CITATION.cff", "Makefile", "pyproject.toml", "robots/*/LICENSE-DATA", "robots/*/*.yaml",
    "examples/*", "bench/*.py",
)  # fmt: skip

TREES = {  # pages of a section, in order; a page that is not named follows those of its room
    "Start": ("docs/start/start", "docs/start/demo", "docs/start/rigid_robots", "docs/start/*"),
    "How to": (
        "docs/howto/importing", "docs/howto/exporting", "docs/howto/several_recordings",
        "docs/howto/planning_experiments", "docs/howto/gain_design",
        "docs/howto/viewing", "docs/howto/adding_an_effect", "docs/howto/testing", "docs/howto/*",
    ),
    "Notebooks": ("notebooks/*",),
    "Reference": (
        "gallery", "api", "cli", "docs/reference/formats", "docs/reference/effects", "docs/reference/robots",
        "docs/reference/settings", "docs/reference/*",
    ),
    "Explained": (
        "docs/explained/conventions", "docs/explained/architecture", "docs/explained/simulation",
        "docs/explained/symbolic", "docs/explained/diagnosis", "docs/explained/method_in_two_pages",
        "docs/explained/*",
    ),
    "Studies": ("docs/studies/diagnosis_study", "docs/studies/*"),
    "Project": ("CHANGELOG", "CONTRIBUTING", "robots/*/README"),
}  # fmt: skip


def main() -> int:
    """Build the site into a folder; the exit code is Sphinx's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--report", type=Path, help="a report to show on the landing page")
    parser.add_argument(
        "--gallery", type=Path, help="a folder that keeps the gallery's pictures between builds"
    )
    given = parser.parse_args()
    source = given.out / "source"
    assemble(source, given.report, given.gallery or given.out / "gallery")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(source)]
    return subprocess.run([*command, str(given.out / "html")], check=False).returncode


def assemble(source: Path, report: Path | None, pictures: Path) -> None:
    """All sources of the site in a folder, which is made anew."""
    shutil.rmtree(source, ignore_errors=True)
    for pattern in (*PAGES, *LINKED):
        for path in sorted(ROOT.glob(pattern)):
            if path.is_file() and "__pycache__" not in path.parts:
                copy = source / path.relative_to(ROOT)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy)
    (source / "_static").mkdir()
    (source / "_extra").mkdir()
    shutil.copyfile(HERE / "conf.py", source / "conf.py")
    shutil.copyfile(HERE / "site.css", source / "_static" / "site.css")
    (source / "api.md").write_text(api(), encoding="utf-8")
    (source / "cli.md").write_text(cli(), encoding="utf-8")
    sys.path.insert(0, str(HERE))
    import gallery

    (source / "gallery.md").write_text(gallery.page(pictures), encoding="utf-8")
    shutil.copytree(pictures, source / "gallery_pictures")
    shown = "![The report of the demo](docs/pictures/report.png)"
    if report is not None:
        shutil.copyfile(report, source / "_extra" / "report.html")
        shown = (
            "The demo's own report, of a real robot; [in a page of its own](report.html):\n\n"
            '<iframe class="report" src="report.html" title="Report of the demo"></iframe>'
        ).replace("[in a page of its own](report.html)", '<a href="report.html">in a page of its own</a>')
    text = (HERE / "index.md").read_text(encoding="utf-8")
    text = text.replace("REPORT", shown).replace("TOCTREES", "\n".join(trees(source)))
    (source / "index.md").write_text(text, encoding="utf-8")


def trees(source: Path) -> Iterator[str]:
    """The tables of contents of the landing page: every page is in one of them."""
    placed = {"index"}
    for caption, patterns in TREES.items():
        pages = []
        for pattern in patterns:
            found = [*source.glob(f"{pattern}.md"), *source.glob(f"{pattern}.ipynb")]
            names = sorted(path.relative_to(source).with_suffix("").as_posix() for path in found)
            pages += [name for name in names if name not in placed]
            placed.update(names)
        yield "\n".join([":::{toctree}", ":hidden:", f":caption: {caption}", "", *pages, ":::", ""])


def api() -> str:
    """Every public name with its docstring: shapes, units, errors."""
    import flexjoint

    kinds: dict[str, list[str]] = {"Functions": [], "Classes": [], "Modules": []}
    for name in flexjoint.__all__:
        thing = getattr(flexjoint, name)
        if inspect.isclass(thing):
            kinds["Classes"] += [f"```{{eval-rst}}\n.. autoclass:: flexjoint.{name}\n   :members:\n```\n"]
        elif inspect.ismodule(thing):
            rows = [f".. automodule:: {thing.__name__}", "   :members:", "   :imported-members:"]
            kinds["Modules"] += [f"### flexjoint.{name}\n", "```{eval-rst}", *rows, "```\n"]
        else:
            kinds["Functions"] += [f"```{{eval-rst}}\n.. autofunction:: flexjoint.{name}\n```\n"]
    head = (
        "# Python\n\nAll names of `import flexjoint as fj`. Quantities are SI, angles in radians, torques"
        " referred to the link.\n"
    )
    return "\n".join([head, *(f"## {kind}\n\n" + "\n".join(entries) for kind, entries in kinds.items())])


def cli() -> str:
    """The help of every command, from the parser itself."""
    from flexjoint.cli.main import _parser

    lines = [
        "# Command line",
        "",
        "Exit code 0 when the work was done, 1 where a check finds a change, 2 on unusable input with one"
        " line that says why.",
        "",
    ]
    for depth, name, parser in commands(_parser(), "flexjoint", 1):
        lines += [
            "#" * min(depth + 1, 4) + f" {name}",
            "",
            "```text",
            parser.format_help().rstrip(),
            "```",
            "",
        ]
    return "\n".join(lines)


def commands(
    parser: argparse.ArgumentParser, name: str, depth: int
) -> Iterator[tuple[int, str, argparse.ArgumentParser]]:
    """A parser and those of its commands, each with its full name."""
    yield depth, name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command, inner in action.choices.items():
                yield from commands(inner, f"{name} {command}", depth + 1)


if __name__ == "__main__":
    sys.exit(main())
