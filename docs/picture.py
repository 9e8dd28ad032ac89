"""Writes docs/robot.webp, the picture of README.md: UR5 of example-robot-data, driven from pose to pose, as `scene.show` draws it.

Usage: python docs/picture.py. Needs phipsi[view], example-robot-data, playwright, pillow, and Chromium.
"""

import io
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

import phipsi

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "python"))
from oracle_pinocchio import ROBOTS  # noqa: E402

#: Of the window, of what is cut from its middle, and of the picture.
WINDOW, CUT, SIZE = (1100, 800), (760, 600), (570, 450)
FRAMES, SECONDS = 48, 1.4
POSES = np.array([[0.3, -1.7, 1.2, -0.6, -1.5, 0.0], [1.2, -1.1, 1.6, -1.6, -1.2, 1.0], [-0.3, -1.5, -1.1, 0.4, 1.5, -0.5], [0.3, -1.7, 1.2, -0.6, -1.5, 0.0]])


def main() -> None:
    scene = phipsi.Scene.from_urdf(ROBOTS / "ur_description/urdf/ur5_robot.urdf")
    q, qd, rows = POSES[0], np.zeros(6), []
    for target in POSES[1:]:
        law = phipsi.PD([200.0, 200.0, 120.0, 30.0, 30.0, 10.0], [60.0, 60.0, 30.0, 6.0, 6.0, 2.0], target)
        path = scene.simulate(q, qd, dt=1e-3, steps=round(1000 * SECONDS), method="rosenbrock-2", pd=law)
        rows += [*path.q[:: round(3000 * SECONDS / FRAMES)]]
        q, qd = path.q[-1], path.qd[-1]
    pictures = []
    with scene.show(rows[0], browser=False) as viewer, sync_playwright() as driver:
        options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        page = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]})
        page.goto(viewer.url)
        canvas = page.locator("canvas").last
        canvas.wait_for()
        page.wait_for_timeout(4000)
        # Hide the controls of the viewer.
        page.add_style_tag(content="body *:not(:has(canvas)):not(canvas) { visibility: hidden; } canvas { visibility: visible !important; }")
        for q in rows:
            viewer.update(q)
            page.wait_for_timeout(350)
            left, top = (WINDOW[0] - CUT[0]) // 2, (WINDOW[1] - CUT[1]) // 2
            whole = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            pictures.append(whole.crop((left, top, left + CUT[0], top + CUT[1])).resize(SIZE))
        browser.close()
    first, *rest = pictures
    file = ROOT / "docs" / "robot.webp"
    first.save(file, save_all=True, append_images=rest, duration=round(3000 * SECONDS / FRAMES), loop=0, quality=70, method=6)
    print(f"written: {file}, {file.stat().st_size} bytes")


if __name__ == "__main__":
    main()
