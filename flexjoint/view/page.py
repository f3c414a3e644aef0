"""A scene as one HTML page that needs nothing else: MeshCat's viewer, the scene and its player inside."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from flexjoint.errors import MissingExtraError
from flexjoint.files import write_text
from flexjoint.view.scene import Scene, packed

ASSETS = Path(__file__).parent / "assets"
HEIGHT = 520  # px of a page in a notebook


@dataclass(frozen=True, eq=False)
class Page:
    """What `flexjoint.view.show` gives: a scene that shows itself in a notebook and writes itself."""

    scene: Scene

    def html(self) -> str:
        """The whole page."""
        parts = {
            "title": html.escape(self.scene.title),
            "style": (ASSETS / "style.css").read_text(encoding="utf-8"),
            "meshcat": _meshcat(),
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

    def _repr_html_(self) -> str:
        text = html.escape(self.html(), quote=True)
        return f'<iframe srcdoc="{text}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'


@lru_cache(maxsize=1)
def _meshcat() -> str:
    """MeshCat's viewer as its package ships it, licences first."""
    try:
        import meshcat
    except ImportError:
        raise MissingExtraError("meshcat", "all") from None
    folder = Path(meshcat.__file__).parent / "viewer"
    licence = (folder / "LICENSE").read_text(encoding="utf-8").replace("*/", "* /")
    return f"/*\n{licence}*/\n" + (folder / "dist" / "main.min.js").read_text(encoding="utf-8")
