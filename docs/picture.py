"""Writes the pictures of README.md and of docs/examples.md with `scene.show(to=...)`: docs/robot.webp, docs/robots.webp, docs/pictures/.

Usage: python docs/picture.py [NAME ...]. Needs phipsi[view], matplotlib, scipy, xacro and
example-robot-data. Without names, all pictures are written.
"""

import re
import runpy
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
from PIL import Image

import phipsi

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
#: Of the pictures of examples.
SIZE = (480, 360)
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


def save(pictures: list[Image.Image], file: Path, each: int) -> None:
    first, *rest = pictures
    first.save(file, save_all=True, append_images=rest, duration=each, loop=0, quality=60, method=6)
    print(f"written: {file}, {file.stat().st_size} bytes")


def main(names: list[str]) -> None:
    PICTURES.mkdir(exist_ok=True)
    shown = re.findall(r"pictures/(\w+)\.webp", (ROOT / "docs" / "examples.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for name in names or dict.fromkeys(shown):
            if name not in ("robot", "robots"):
                save(*swapped(frames(of_example(name, Path(folder)), SIZE), PICTURES / f"{name}.webp"))
        if not names or "robots" in names:
            panels = [frames(PICTURES / f"{name}.webp", PANEL)[0] for name in FIRST]
            strip = []
            for at in range(max(map(len, panels))):
                strip.append(Image.new("RGB", (len(FIRST) * PANEL[0], PANEL[1]), "white"))
                for i, panel in enumerate(panels):
                    strip[-1].paste(panel[at % len(panel)], (i * PANEL[0], 0))
            save(strip, ROOT / "docs" / "robots.webp", 50)
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
    print(phipsi.__file__)
    main(sys.argv[1:])
