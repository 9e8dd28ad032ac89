"""Writes the pictures of README.md, docs/examples.md and docs/how-to/: docs/robot.webp, docs/robots.webp, docs/simulate.webp, docs/pictures/, docs/how-to/pictures/.

Usage: python docs/picture.py [NAME ...]. Needs phipsi[view,report], matplotlib, scipy, xacro, playwright with Chromium and
example-robot-data. Without names, all pictures are written. A name of a how-to page begins with how-to/, such as how-to/lqr.
"""

import os
import re
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

import phipsi

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
#: Of the pictures of examples.
SIZE = (480, 360)
#: Of the pictures of how-to pages, and their largest size, bytes.
PAGE, LARGEST = (400, 300), 59_000
#: Panels of docs/robots.webp, all in motion the whole time, and their size.
FIRST, PANEL = ("go2", "panda", "talos"), (300, 225)


def of_example(name: str, folder: Path) -> Path:
    """Animation of an example."""
    found = runpy.run_path(str(ROOT / "python" / "phipsi" / "examples" / f"{name}.py"))
    scene: Any = found["scene"]
    if "path" in found:
        scene.show(found["path"], to=folder / f"{name}.webp")
    else:
        scene.show(found["q"], t=found["t"], to=folder / f"{name}.webp")
    return folder / f"{name}.webp"


def frames(file: Path, size: tuple[int, int]) -> tuple[list[Image.Image], int]:
    """Pictures of an animation, and the time of each, ms."""
    with Image.open(file) as opened:
        found: list[Image.Image] = []
        # Equal pictures are stored once, for a longer time.
        for at in range(opened.n_frames):
            opened.seek(at)
            found += [opened.convert("RGB").resize(size, Image.Resampling.LANCZOS)] * max(round(opened.info["duration"] / 50.0), 1)
    return found, 50


def cropped(pictures: list[Image.Image]) -> list[Image.Image]:
    """The part in which a robot moves, as wide as a panel."""
    still = np.asarray(pictures[0], float)[:, :1]
    changed = np.any([np.abs(np.asarray(one, float) - still).max(axis=-1) > 60 for one in pictures], axis=0)
    (low_y, low_x), (high_y, high_x) = (f(np.argwhere(changed), axis=0) for f in (np.min, np.max))
    width, height = pictures[0].size
    part = min(max((high_x - low_x) / width, (high_y - low_y) / height) * 1.12, 1.0)
    left = np.clip((low_x + high_x) / 2 - part * width / 2, 0, width * (1 - part))
    top = np.clip((low_y + high_y) / 2 - part * height / 2, 0, height * (1 - part))
    return [one.resize(PANEL, Image.Resampling.LANCZOS, (left, top, left + part * width, top + part * height)) for one in pictures]


def save(pictures: list[Image.Image], file: Path, each: int, quality: int = 60) -> None:
    first, *rest = pictures
    first.save(file, save_all=True, append_images=rest, duration=each, loop=0, quality=quality, method=6)
    print(f"written: {file}, {file.stat().st_size} bytes")


def of_page(name: str, folder: Path) -> None:
    """The picture that the code of a how-to page and its comment `picture` draw."""
    sys.path.insert(0, str(ROOT / "tests" / "python"))
    from page_script import parts

    code, picture, _ = parts((ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8").splitlines())
    drawn = folder / f"{Path(name).name}.webp"
    found: dict[str, Any] = {"__name__": "picture", "PICTURE": str(drawn)}
    here = Path.cwd()
    os.chdir(folder)
    try:
        exec(compile("\n".join(code), name, "exec"), found)
    except ImportError as error:
        # Pictures of pages whose package only some machines have are drawn without it.
        print(f"{name}: {error}")
    exec(compile("\n".join(picture), name, "exec"), found)
    os.chdir(here)
    target = ROOT / "docs" / "how-to" / "pictures" / drawn.name
    target.parent.mkdir(exist_ok=True)
    with Image.open(drawn) as opened:
        shown = [opened.convert("RGB")]
        moves = getattr(opened, "n_frames", 1) > 1
    each = 50
    if moves:
        shown, each = frames(drawn, PAGE)
    elif shown[0].size == (800, 600):
        shown[0].thumbnail(PAGE)
    for quality in (75, 60, 45, 30, 20):
        save(shown, target, each, quality)
        if target.stat().st_size <= LARGEST:
            return
        if moves:
            shown, each = shown[::2], 2 * each
    raise SystemExit(f"{target}: found {target.stat().st_size} bytes; expected at most {LARGEST}: a shorter motion")


def of_simulate(folder: Path) -> Image.Image:
    """The page of `phipsi simulate` in a browser."""
    sys.path.insert(0, str(ROOT / "tests" / "python"))
    from browsing import CHROMIUM, OPTIONS, PATIENCE
    from playwright.sync_api import sync_playwright

    subprocess.run([sys.executable, "-m", "phipsi", "simulate", "-o", str(folder), "--time", "2"], check=True)
    with sync_playwright() as driver:
        page = driver.chromium.launch(executable_path=CHROMIUM, args=OPTIONS).new_page(viewport={"width": 1000, "height": 1780})
        page.goto((folder / "index.html").as_uri())
        frame = page.frame_locator("iframe.robot")
        # The warning that there is no graphics processor.
        frame.locator(".mantine-Notification-closeButton").click(timeout=PATIENCE)
        page.wait_for_timeout(20_000)
        page.screenshot(path=folder / "page.png", timeout=PATIENCE)
    return Image.open(folder / "page.png").convert("RGB").resize((700, 1246), Image.Resampling.LANCZOS)


def main(names: list[str]) -> None:
    PICTURES.mkdir(exist_ok=True)
    shown = re.findall(r"pictures/(\w+)\.webp", (ROOT / "docs" / "examples.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for name in names or dict.fromkeys(shown):
            if name not in ("robot", "robots", "simulate") and not name.startswith("how-to/"):
                save(*swapped(frames(of_example(name, Path(folder)), SIZE), PICTURES / f"{name}.webp"))
        for page in sorted((ROOT / "docs" / "how-to").glob("*.md")):
            name = f"how-to/{page.stem}"
            if name in names or (not names and "<!-- picture" in page.read_text(encoding="utf-8")):
                of_page(name, Path(folder))
        if not names or "robots" in names:
            panels = [cropped(frames(PICTURES / f"{name}.webp", SIZE)[0]) for name in FIRST]
            strip = []
            for at in range(max(map(len, panels))):
                strip.append(Image.new("RGB", (len(FIRST) * PANEL[0], PANEL[1]), "white"))
                for i, panel in enumerate(panels):
                    strip[-1].paste(panel[at % len(panel)], (i * PANEL[0], 0))
            save(strip, ROOT / "docs" / "robots.webp", 50, 40)
        if not names or "simulate" in names:
            save([of_simulate(Path(folder))], ROOT / "docs" / "simulate.webp", 50)
        if not names or "robot" in names:
            (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
            found: dict[str, Any] = {}
            exec(compile(code, "README.md", "exec"), found)
            found["scene"].show(found["path"], to=Path(folder) / "robot.webp")
            save(*swapped(frames(Path(folder) / "robot.webp", SIZE), ROOT / "docs" / "robot.webp"))


def swapped(animation: tuple[list[Image.Image], int], file: Path) -> tuple[list[Image.Image], Path, int]:
    """Arguments of save."""
    return animation[0], file, animation[1]


if __name__ == "__main__":
    matplotlib.use("agg")
    matplotlib.rcParams |= {"savefig.bbox": "tight", "savefig.dpi": 110, "axes.spines.top": False, "axes.spines.right": False}
    print(phipsi.__file__)
    main(sys.argv[1:])
