"""Pictures and video of a page, by a Chromium without a window.

It is spoken to through two pipes (`--remote-debugging-pipe`: JSON messages that end in a zero byte, Chrome
DevTools Protocol), so that no port is opened, and nothing is fetched: the page is a file.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.progress import Report, part, silent

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
DRAWING = 0.9  # share of a video's time that its frames take
PATIENCE = 120.0  # s for one answer: a large scene in software on a slow machine
FLAGS = (
    "--headless=new",
    "--no-sandbox",  # root and containers have none, and the page is our own
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--hide-scrollbars",
    "--mute-audio",
    "--disable-dev-shm-usage",
    "--remote-debugging-pipe",
)


class NoBrowserError(FlexJointError):
    """There is no browser to make pictures with."""


@dataclass
class Said:
    """What a page said: console errors and exceptions, and the addresses that it asked for."""

    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


def find() -> str:
    """The path of a Chromium or Chrome; raises NoBrowserError where none is installed."""
    for name in NAMES:
        path = shutil.which(name)
        if path:
            return path
    raise NoBrowserError(
        f"no browser found, looked for {', '.join(NAMES)}; install Chromium for pictures and video"
        " (the HTML page needs none)"
    )


def find_encoder() -> str:
    """The path of ffmpeg; raises FlexJointError where it is not installed."""
    path = shutil.which("ffmpeg")
    if path is None:
        raise FlexJointError(
            "ffmpeg is not installed, which makes the video; install it, or write the images alone"
        )
    return path


class Browser:
    """A headless browser with one page open. Use as a context manager.

    Args:
        page: an HTML file.
        size: of the picture, width and height [px].

    Raises NoBrowserError, or FlexJointError where the browser does not start or answer.
    """

    def __init__(self, page: Path, size: tuple[int, int] = (1280, 800)) -> None:
        if os.name != "posix":
            raise NoBrowserError("pictures need Linux or macOS; open the HTML page and take them there")
        self.said = Said()
        self._count, self._session, self._rest = 0, "", b""
        self._profile = tempfile.TemporaryDirectory(prefix="flexjoint-", ignore_cleanup_errors=True)
        flags = [*FLAGS, f"--user-data-dir={self._profile.name}", "about:blank"]
        self._process, self._in, self._out = _spawned([find(), *flags])
        try:
            self._open(page, size)
        except BaseException:
            self.close()
            raise

    def _open(self, page: Path, size: tuple[int, int]) -> None:
        targets = self._call("Target.getTargets")["targetInfos"]
        own = next(item["targetId"] for item in targets if item["type"] == "page")
        self._session = self._call("Target.attachToTarget", targetId=own, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")
        width, height = size
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        self._call("Page.navigate", url=f"{page.resolve().as_uri()}#t=0")  # at rest
        self._until("window.flexjoint || window.flexjointFailed")
        failed = self.evaluate("window.flexjointFailed")
        if failed:
            raise FlexJointError(f"the page failed: {failed}")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and remove its profile."""
        os.close(self._out)  # it ends when its commands do
        end = time.monotonic() + 5.0
        while os.waitpid(self._process, os.WNOHANG)[0] == 0:
            if time.monotonic() > end:
                os.kill(self._process, signal.SIGKILL)
                os.waitpid(self._process, 0)
                break
            time.sleep(0.02)
        os.close(self._in)
        self._profile.cleanup()

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page (a promise is awaited)."""
        answer = self._call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )  # fmt: skip
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            text = details.get("exception", {}).get("description", details.get("text", ""))
            raise FlexJointError(f"the page failed: {' '.join(str(text).split())}")
        return answer["result"].get("value")

    def picture(self) -> bytes:
        """The page as it is, as PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def frame(self, index: int) -> bytes:
        """The page at one of its frames, as PNG."""
        self.evaluate(f"flexjoint.pause(); flexjoint.show({index}); flexjoint.draw();")
        return self.picture()

    # --- protocol -----------------------------------------------------------------------------------------
    def _until(self, condition: str) -> None:
        end = time.monotonic() + PATIENCE
        while not self.evaluate(f"Boolean({condition})"):
            if time.monotonic() > end:
                raise FlexJointError("the page did not come up in the browser; open it by hand to see why")
            time.sleep(0.05)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        try:
            data = json.dumps(message).encode() + b"\0"
            while data:
                data = data[os.write(self._out, data) :]
        except OSError:
            raise FlexJointError("the browser ended; is it able to start on this machine?") from None
        while True:
            answer = self._message()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise FlexJointError(f"the browser refused {method}: {answer['error'].get('message')}")
                return answer["result"]
            self._heard(answer)

    def _message(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            chunk = os.read(self._in, 1 << 20) if ready else b""
            if not ready:
                raise FlexJointError(f"the browser did not answer within {PATIENCE:g} s")
            if not chunk:
                raise FlexJointError("the browser ended; is it able to start on this machine?")
            self._rest += chunk
        raw, _, self._rest = self._rest.partition(b"\0")
        return json.loads(raw)

    def _heard(self, event: dict[str, Any]) -> None:
        name, details = event.get("method"), event.get("params", {})
        if name == "Runtime.exceptionThrown":
            thrown = details["exceptionDetails"]
            self.said.errors.append(str(thrown.get("exception", {}).get("description", thrown.get("text"))))
        elif name == "Runtime.consoleAPICalled" and details["type"] == "error":
            self.said.errors.append(" ".join(str(arg.get("value", arg)) for arg in details["args"]))
        elif name == "Log.entryAdded" and details["entry"]["level"] == "error":
            self.said.errors.append(str(details["entry"]["text"]))
        elif name == "Network.requestWillBeSent":
            self.said.requests.append(str(details["request"]["url"]))


def _spawned(command: list[str]) -> tuple[int, int, int]:
    """A process whose descriptors 3 and 4 are pipes: its id, what it writes, what it reads."""
    import fcntl  # not on every system

    reads, out = os.pipe()
    answers, writes = os.pipe()
    # above 9, so that putting the one in its place does not overwrite the other
    high_reads, high_writes = fcntl.fcntl(reads, fcntl.F_DUPFD, 10), fcntl.fcntl(writes, fcntl.F_DUPFD, 10)
    os.set_inheritable(high_reads, False)
    os.set_inheritable(high_writes, False)
    actions: list[tuple[Any, ...]] = [
        *((os.POSIX_SPAWN_OPEN, k, os.devnull, os.O_RDWR, 0) for k in range(3)),
        (os.POSIX_SPAWN_DUP2, high_reads, 3),
        (os.POSIX_SPAWN_DUP2, high_writes, 4),
    ]
    try:
        process = os.posix_spawn(command[0], command, os.environ, file_actions=actions, setpgroup=0)
    except OSError as error:
        os.close(out)
        os.close(answers)
        raise FlexJointError(f"the browser {command[0]} does not start: {error.strerror}") from None
    finally:
        for descriptor in (reads, writes, high_reads, high_writes):
            os.close(descriptor)
    return process, answers, out


@contextlib.contextmanager
def opened(html: str, size: tuple[int, int]) -> Iterator[Browser]:
    """A browser on a page that is given as text."""
    with tempfile.TemporaryDirectory(prefix="flexjoint-", ignore_cleanup_errors=True) as folder:
        page = Path(folder) / "page.html"
        page.write_text(html, encoding="utf-8")
        with Browser(page, size) as browser:
            yield browser


def images(
    html: str, frames: Sequence[int], folder: Path, size: tuple[int, int], report: Report = silent
) -> list[Path]:
    """The frames of a page as frame_00000.png and so on in the folder, which is made; existing files of these
    names are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    with opened(html, size) as browser:
        browser.evaluate("document.body.classList.add('plain'); window.dispatchEvent(new Event('resize'))")
        for k, index in enumerate(frames):
            report(k / len(frames), "drawing frames")
            out.append(folder / f"frame_{k:05d}.png")
            out[-1].write_bytes(browser.frame(index))
        if browser.said.errors:
            raise FlexJointError(f"the page reported an error: {' '.join(browser.said.errors[0].split())}")
    return out


def video(
    html: str,
    frames: Sequence[int],
    rate: float,
    path: Path,
    size: tuple[int, int],
    report: Report = silent,
) -> Path:
    """The frames of a page as a video by ffmpeg; raises FlexJointError where there is no ffmpeg."""
    encoder = find_encoder()
    even = (size[0] // 2 * 2, size[1] // 2 * 2)  # yuv420p halves the colours
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="flexjoint-", ignore_cleanup_errors=True) as folder:
        images(html, frames, Path(folder), even, part(report, 0.0, DRAWING))
        report(DRAWING, "encoding")
        source = ["-framerate", f"{rate:g}", "-i", str(Path(folder) / "frame_%05d.png")]
        command = [encoder, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise FlexJointError(f"ffmpeg failed: {' '.join(done.stderr.split())[-300:]}")
    return path
