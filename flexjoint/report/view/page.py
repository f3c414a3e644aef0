"""A scene as one HTML page that needs nothing else: MeshCat's viewer, the scene and its player inside."""

from __future__ import annotations

import html
import importlib.util
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from flexjoint.core.errors import MissingExtraError
from flexjoint.core.files import write_text
from flexjoint.core.running.progress import Report, silent
from flexjoint.report.view import browser
from flexjoint.report.view.scene import Scene, packed

ASSETS = Path(__file__).parent / "assets"
HEIGHT = 520  # px of a page in a notebook


@dataclass(frozen=True, eq=False)
class Page:
    """What `flexjoint.report.view.show` gives: a scene that shows itself in a notebook and writes itself."""

    scene: Scene

    def html(self) -> str:
        """The whole page."""
        parts = {
            "title": html.escape(self.scene.title),
            "style": (ASSETS / "style.css").read_text(encoding="utf-8"),
            "meshcat": meshcat_viewer(),
            "scene": packed(self.scene),
            "player": (ASSETS / "player.js").read_text(encoding="utf-8"),
        }
        page = (ASSETS / "page.html").read_text(encoding="utf-8")
        head, *rest = page.split("{{")
        return head + "".join(parts[name] + text for name, text in (item.split("}}", 1) for item in rest))

    def write_html(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; the file appears whole or not at all."""
        out = Path(path)
        write_text(out, self.html())
        return out

    @property
    def rate(self) -> float:
        """Frames per second."""
        times = self.scene.times
        return (len(times) - 1) / float(times[-1] - times[0]) if len(times) > 1 else 1.0

    def frames(self, every: int = 1) -> range:
        """Indices of every so many frames."""
        return range(0, len(self.scene.times), max(1, every))

    def write_images(
        self,
        folder: str | os.PathLike[str],
        size: tuple[int, int] = (1280, 800),
        every: int = 1,
        progress: Report | None = None,
    ) -> list[Path]:
        """Every so many frames as PNG, by a headless Chromium; NoBrowserError where there is none."""
        return browser.images(self.html(), self.frames(every), Path(folder), size, progress or silent)

    def write_video(
        self,
        path: str | os.PathLike[str],
        size: tuple[int, int] = (1280, 800),
        every: int = 1,
        progress: Report | None = None,
    ) -> Path:
        """The frames as a video, by a headless Chromium and ffmpeg."""
        rate, frames = self.rate / max(1, every), self.frames(every)
        return browser.video(self.html(), frames, rate, Path(path), size, progress or silent)

    def _repr_html_(self) -> str:
        text = html.escape(self.html(), quote=True)
        return f'<iframe srcdoc="{text}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'


@lru_cache(maxsize=1)
def meshcat_viewer() -> str:
    """MeshCat's viewer as its package ships it, licences first; MissingExtraError where there is none."""
    found = importlib.util.find_spec("meshcat")  # its files are needed, not its server
    if found is None or found.origin is None:
        raise MissingExtraError("meshcat", "report")
    folder = Path(found.origin).parent / "viewer"
    licence = (folder / "LICENSE").read_text(encoding="utf-8").replace("*/", "* /")
    return f"/*\n{licence}*/\n" + (folder / "dist" / "main.min.js").read_text(encoding="utf-8")
