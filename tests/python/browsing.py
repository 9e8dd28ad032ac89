"""Pages in a headless Chromium, if it is installed: network requests, script errors, and screenshots."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
#: Options for a container: no graphics processor, and the root user.
OPTIONS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
needs_browser = pytest.mark.skipif(CHROMIUM is None and "PHIPSI_NEEDS_BROWSER" not in os.environ, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield opened
        opened.close()


#: Timeout on a busy machine, ms.
PATIENCE = 120_000


class Opened:
    """A page, and its network requests."""

    def __init__(self, browser: Any, file: Path, width: int) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": 600})
        self.asked: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.goto(file.as_uri())

    def __enter__(self) -> Opened:
        return self

    def __exit__(self, *_: object) -> None:
        # Otherwise it would continue to draw.
        self.page.close()

    def check(self, file: Path) -> None:
        foreign = [url for url in self.asked if url != file.as_uri() and not url.startswith(("data:", "blob:", "about:"))]
        assert not foreign and not self.errors, (foreign, self.errors)

    def picture(self, canvas: Any) -> np.ndarray:
        from PIL import Image

        canvas.evaluate("element => element.scrollIntoView()")
        whole = self.page.screenshot(clip=canvas.bounding_box(), timeout=PATIENCE)
        return np.asarray(Image.open(io.BytesIO(whole)).convert("RGB"), float)

    def plots(self) -> list[dict[str, Any]]:
        """Wait until every plot is drawn. For each: its name, the number of drawn traces, and text that is cut off or
        overlaps.
        """
        self.page.wait_for_function("window.plots", timeout=PATIENCE)
        self.page.evaluate("() => window.plots")
        found: list[dict[str, Any]] = self.page.evaluate(PLOTS)
        return found

    def resize(self, width: int) -> None:
        """Set the width of the window, and wait until its plots have adapted."""
        self.page.set_viewport_size({"width": width, "height": 600})
        self.page.wait_for_function(FOLLOWED, timeout=PATIENCE)

    def wide(self) -> int:
        """Width of the page, px: larger than that of the window if it scrolls horizontally."""
        return int(self.page.evaluate("document.documentElement.scrollWidth"))


#: Whether every drawn plot has the layout and the width of its window.
FOLLOWED = """() => window.plots && [...document.querySelectorAll('.plot')].every(place => {
  const canvas = place.querySelector('.canvas'), full = canvas._fullLayout;
  return full && Math.abs(full.width - canvas.clientWidth) < 2 && Math.abs(full.height - canvas.clientHeight) < 2;
})"""
#: Text of a plot outside its frame, and overlapping tick labels, titles and legend entries.
PLOTS = """() => [...document.querySelectorAll('.plot')].map(place => {
  const canvas = place.querySelector('.canvas'), frame = canvas.getBoundingClientRect();
  const boxes = query => [...place.querySelectorAll(query)].filter(e => e.textContent.trim()).map(e => [e.textContent, e.getBoundingClientRect()]).filter(([, b]) => b.width > 0);
  const texts = boxes('.xtick text, .ytick text, .g-xtitle text, .g-ytitle text, .xtitle, .ytitle, .x2title, .y2title, .annotation-text, .cbaxis text');
  const names = boxes('.legend button');
  const out = texts.filter(([, b]) => b.left < frame.left - 2 || b.right > frame.right + 2 || b.top < frame.top - 2 || b.bottom > frame.bottom + 2);
  const beyond = names.filter(([, b]) => b.right > innerWidth + 1 || b.left < -1);
  const over = [];
  for (const group of [texts, names]) group.forEach(([one, a], i) => group.slice(i + 1).forEach(([other, b]) => {
    if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1 && one !== other) over.push(one + ' | ' + other);
  }));
  const inside = canvas._fullData.filter(trace => trace.visible === true && (trace.x || []).length);
  const drawn = place.querySelectorAll('.scatterlayer .trace, .heatmaplayer image, .gl-container canvas').length;
  return {name: place.id, traces: inside.length, drawn, cut: out.concat(beyond).map(([text]) => text), over, legend: names.map(([text]) => text), width: frame.width};
})"""
