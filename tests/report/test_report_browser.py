"""The report in a real headless browser, the network off: no complaint, tables sort, plots zoom,
it fits a phone and prints."""

from __future__ import annotations

import base64
import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.browsers import near, need_browser, pixels
from support.fake_diagnosis import arm, causes, preload, signals, simulation, traced, views

from flexjoint import report
from flexjoint.core.errors import FlexJointError
from flexjoint.report.view.browser import Browser, opened

DESK, PHONE = (1280, 900), (390, 800)
BEFORE, AFTER = (194, 87, 12), (11, 92, 173)  # colours of the two models (plots.py)
TABLE = "document.querySelectorAll('table.numbers')[1]"  # errors per channel
COLUMN = f"[...{TABLE}.tBodies[0].rows].map(row => row.cells[{{}}].textContent.trim())"


@pytest.fixture(scope="module", autouse=True)
def browser_there() -> None:
    need_browser()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    measured = signals(seconds=8.0)
    sims = simulation(measured, 0.5), simulation(measured, 0.05)
    found = causes(measured, *sims)
    found = replace(found, findings=(*found.findings, preload()), residuals=views(measured))
    return report.render(traced(found), arm(tmp_path_factory.mktemp("arm2")), measured, *sims)


@pytest.fixture(scope="module")
def browser(page: str) -> Iterator[Browser]:
    with opened(page, DESK) as browser:
        browser._call(
            "Network.emulateNetworkConditions",
            offline=True, latency=0, downloadThroughput=0, uploadThroughput=0,
        )  # fmt: skip
        yield browser


@pytest.fixture
def desk(browser: Browser) -> Iterator[Browser]:
    yield from loaded(browser, DESK)


@pytest.fixture
def phone(browser: Browser) -> Iterator[Browser]:
    yield from loaded(browser, PHONE)


def loaded(browser: Browser, size: tuple[int, int]) -> Iterator[Browser]:
    """The page anew; after the test, no complaint and no request that leaves the page."""
    browser._call("Emulation.setEmulatedMedia", media="screen")
    resize(browser, size)
    browser.evaluate("window.old = true")
    browser._call("Page.reload")
    end, there = time.monotonic() + 60.0, False
    while not there:
        assert time.monotonic() < end
        with contextlib.suppress(FlexJointError):  # asked of the page that goes
            there = browser.evaluate(
                "!window.old && Boolean(window.flexjoint) && document.readyState === 'complete'"
            )
    yield browser
    assert browser.said.errors == []
    assert {url.split(":")[0] for url in browser.said.requests} <= {"file", "data"}


def resize(browser: Browser, size: tuple[int, int]) -> None:
    width, height = size
    browser._call(
        "Emulation.setDeviceMetricsOverride",
        width=width, height=height, deviceScaleFactor=1, mobile=width < 500,
    )  # fmt: skip


def key(browser: Browser, name: str) -> None:
    browser.evaluate(
        f"document.querySelector('dialog').dispatchEvent(new KeyboardEvent('keydown', {{key: '{name}'}}))"
    )


def test_a_click_on_a_head_sorts_and_another_sorts_back(desk: Browser) -> None:
    def click(column: int) -> list[str]:
        desk.evaluate(f"{TABLE}.tHead.rows[0].cells[{column}].querySelector('button').click()")
        return desk.evaluate(COLUMN.format(column))

    before = desk.evaluate(COLUMN.format(6))
    largest = [float(text.split()[0]) for text in click(6)]
    assert largest == sorted(largest, reverse=True) and len(set(largest)) > 3
    assert desk.evaluate(f"{TABLE}.tHead.rows[0].cells[6].ariaSort") == "descending"
    smallest = [float(text.split()[0]) for text in click(6)]
    assert smallest == sorted(smallest)
    assert click(6) == before
    # which joint a row belongs to is seen in any order
    colours = f"[...{TABLE}.querySelectorAll('tbody th')].map(cell => getComputedStyle(cell).color)"
    click(0)
    assert set(desk.evaluate(colours)) == {"rgb(31, 41, 51)"}


def test_what_is_not_known_stands_last_in_either_order(desk: Browser) -> None:
    desk.evaluate(f"{TABLE}.tBodies[0].rows[0].cells[2].textContent = '–'")
    for way in (1, -1):
        desk.evaluate(f"flexjoint.sort({TABLE}, 2, {way})")
        assert desk.evaluate(COLUMN.format(2))[-1] == "–"


def test_candidates_sort_by_their_share(desk: Browser) -> None:
    table = "document.querySelector('.ranking')"
    desk.evaluate(f"{table}.tHead.querySelectorAll('button')[1].click()")  # largest first, as they were
    desk.evaluate(f"{table}.tHead.querySelectorAll('button')[1].click()")
    shares = desk.evaluate(f"[...{table}.tBodies[0].rows].map(row => parseFloat(row.cells[2].textContent))")
    assert shares == sorted(shares) and len(shares) == 6


def test_a_plot_is_enlarged_and_zoomed(desk: Browser) -> None:
    """The window follows wheel, keys and drag; the curves stay under their axes."""
    desk.evaluate("document.querySelectorAll('img[data-axes]')[0].click()")
    assert desk.evaluate("document.querySelector('dialog').open") is True
    whole = desk.evaluate("flexjoint.view()")
    picture = pixels(desk.picture())
    assert near(picture, BEFORE) > 300 and near(picture, AFTER) > 300
    desk.evaluate("flexjoint.zoom(0.5, [0.5, 0.5])")
    half = desk.evaluate("flexjoint.view()")
    # nine digits of the limits are in the page
    np.testing.assert_allclose(half[1] - half[0], 0.5 * (whole[1] - whole[0]), rtol=1e-6)
    labels = "[...document.querySelectorAll('.stage > svg > g text')].map(node => node.textContent)"
    assert "time [s]" in desk.evaluate(labels)
    key(desk, "ArrowRight")
    moved = desk.evaluate("flexjoint.view()")
    np.testing.assert_allclose(moved[0] - half[0], 0.2 * (half[1] - half[0]), rtol=1e-6)
    for _ in range(60):
        key(desk, "+")
    deepest = desk.evaluate("flexjoint.view()")
    np.testing.assert_allclose(deepest[1] - deepest[0], 1e-4 * (whole[1] - whole[0]), rtol=1e-6)
    key(desk, "0")
    assert desk.evaluate("flexjoint.view()") == whole
    left, top, width, height = desk.evaluate(
        "(() => { const b = document.querySelector('.stage').getBoundingClientRect();"
        " return [b.left, b.top, b.width, b.height]; })()"
    )
    for kind, x, y in (("Pressed", 0.3, 0.2), ("Moved", 0.6, 0.6), ("Released", 0.6, 0.6)):
        desk._call(
            "Input.dispatchMouseEvent", type=f"mouse{kind}", x=left + x * width, y=top + y * height,
            button="left", buttons=1, clickCount=1,
        )  # fmt: skip
    boxed = desk.evaluate("flexjoint.view()")
    assert whole[0] < boxed[0] < boxed[1] < whole[1] and whole[2] < boxed[2] < boxed[3] < whole[3]
    assert 0.25 < (boxed[1] - boxed[0]) / (whole[1] - whole[0]) < 0.4
    desk.evaluate("document.querySelectorAll('dialog button')[1].click()")
    desk._until("!document.querySelector('dialog')")


def test_a_zoomed_curve_is_where_the_axes_say(desk: Browser) -> None:
    """The shaded stretch of an error plot, whose ends the caption states, lies between these ends."""
    desk.evaluate("document.querySelectorAll('img[data-axes]')[1].click()")
    start, stop = stretch(desk)
    whole = desk.evaluate("flexjoint.view()")
    desk.evaluate(f"flexjoint.show([{start - 0.5}, {stop + 0.5}, {whole[2]}, {whole[3]}])")
    picture = pixels(desk.picture())
    shaded = np.all(np.abs(picture - np.array([228, 231, 235])) < 3, axis=2)
    columns = np.flatnonzero(shaded.sum(axis=0) > 100)
    left, right = desk.evaluate(
        "(() => { const left = document.querySelector('.stage').getBoundingClientRect().left;"
        " const { x, width } = document.querySelector('.stage svg svg');"
        " return [left + x.baseVal.value, left + x.baseVal.value + width.baseVal.value]; })()"
    )
    width = (right - left) / (stop - start + 1.0)  # pixels a second
    # the caption rounds to 0.05 s; a pixel is less
    assert columns.min() == pytest.approx(left + 0.5 * width, abs=0.06 * width + 2)
    assert columns.max() == pytest.approx(right - 0.5 * width, abs=0.06 * width + 2)


def stretch(browser: Browser) -> list[float]:
    """Start and end of the first joint's excerpt, as its head says."""
    heads = browser.evaluate("[...document.querySelectorAll('h3 small')].map(node => node.textContent)")
    said = next(head for head in heads if " to " in head and head.endswith(" s"))
    return [float(number) for number in said.removesuffix(" s").split(" to ")]


def test_it_fits_a_phone(phone: Browser) -> None:
    assert phone.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
    # nothing is cut: what is wider than the page scrolls within itself
    wide = (
        "[...document.querySelectorAll('main *')].filter(node => !node.closest('.wide')"
        " && node.getBoundingClientRect().right > innerWidth + 1).map(node => node.outerHTML.slice(0, 80))"
    )
    assert phone.evaluate(wide) == []
    sizes = (
        "[...document.querySelectorAll('p, td, th, dd')]"
        ".map(node => parseFloat(getComputedStyle(node).fontSize))"
    )
    assert min(phone.evaluate(sizes)) >= 12.0
    phone.evaluate("document.querySelectorAll('img[data-axes]')[0].click()")
    box = phone.evaluate(
        "(() => { const b = document.querySelector('.stage').getBoundingClientRect();"
        " return [b.left, b.right, b.height]; })()"
    )
    assert box[0] >= 0 and box[1] <= PHONE[0] and box[2] > 400


def test_it_prints_whole(desk: Browser, tmp_path: Path) -> None:
    """Pages of A4, folded steps open, no words for the mouse, no column one letter wide."""
    desk._call("Emulation.setEmulatedMedia", media="print")
    desk.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert desk.evaluate("document.querySelector('details').open") is True
    assert desk.evaluate("getComputedStyle(document.querySelector('.live')).display") == "none"
    resize(desk, (718, 1000))  # A4 within its margins
    narrow = (
        "[...document.querySelectorAll('.facts th')].filter(cell =>"
        " cell.getBoundingClientRect().width < 60).length"
    )
    assert desk.evaluate(narrow) == 0  # "removes" is some 55 px wide
    assert desk.evaluate("document.documentElement.scrollWidth") <= 718
    desk.evaluate("dispatchEvent(new Event('afterprint'))")
    assert desk.evaluate("document.querySelector('details').open") is False
    pdf = base64.b64decode(desk._call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)["data"])
    assert pdf.startswith(b"%PDF") and 4 <= pdf.count(b"/Type /Page\n") <= 12
