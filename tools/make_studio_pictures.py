"""Make the pictures of docs/studio.md: the studio's states, light and dark, wide and narrow.

    python tools/make_studio_pictures.py [STATE ...]

Needs Chromium and the package playwright. Each picture has at most 300 kB.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "studio"))

from browser import AIM, Page, chromium  # noqa: E402
from studio_process import Studio  # noqa: E402

OUT = ROOT / "docs" / "studio"
MOST = 300_000


def shot(page: Page, name: str) -> None:
    """Write a picture with as many colours as it may have."""
    from io import BytesIO

    from PIL import Image

    page.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    page.value("studio.view()?.panes.length && studio.view().draw(true)")  # a line more or less changes its size
    picture = Image.open(BytesIO(page.page.screenshot())).convert("RGB")
    path = OUT / f"{name}.png"
    often, rare = picture.quantize(160), picture.quantize(96, method=Image.Quantize.MAXCOVERAGE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(often.getpalette() or [])[:480], *(rare.getpalette() or [])[:288]])
    picture.quantize(palette=palette, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size <= MOST, f"{path} has {path.stat().st_size} bytes"
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")


def first(page: Page) -> None:
    """What somebody sees who starts it for the first time."""
    page.page.wait_for_selector(".pictured img", state="attached")  # a phone has it in a sheet
    page.set(1.6)


def sentence(page: Page) -> None:
    """A sentence with words that are not understood."""
    page.set(1.0)
    page.page.fill("#sentence", "walks forward and frobnicates")
    page.page.wait_for_selector(".backdrop u")


def takes(page: Page) -> None:
    """Four takes side by side."""
    page.page.click("text=four takes")
    page.type("kicks with the right leg")
    page.until("studio.view().panes.length === 4")
    page.until("studio.takes.value.slice(0, 4).every((one) => one.state === 'done')")
    page.until("studio.view().panes.every((pane) => pane.clip)")
    page.page.click(".takes li:nth-child(2) .icon >> nth=0")
    page.set(1.5)
    page.page.click("text=one take")


def handles(page: Page) -> None:
    """Handles in colour."""
    page.page.click("#body > summary")
    page.page.select_option("#colouring", "handles")
    page.set(0.8)


def directing(page: Page) -> None:
    """A timeline of sentences with a span, poses, pins and a path."""
    page.page.click("#sample-person")
    page.until("studio.character.value?.name === 'person' && studio.take.value?.state === 'done'")
    page.shown()
    page.value(
        """studio.change('', {
            script: [{ text: 'walks forward', seconds: 4 }, { text: 'jumps', seconds: 2 }],
            path: [[0, 0], [0.4, 0.9], [1.2, 1.6], [2.4, 1.8], [3.4, 1.4]], sentence: 0 })"""
    )
    page.page.click("#animate")
    page.until("studio.take.value.script.length === 2 && studio.take.value.state === 'done'")
    page.shown()
    page.set(1.0)
    page.page.click("#fold")
    page.page.click("button:has-text('Pin this pose')")
    page.set(3.2)
    page.page.click("button:has-text('Pin this pose')")
    page.value(
        """studio.change('', { span: [1.5, 3.0], keep: ['legs'],
            pins: [{ part: 'left_hand', time: 2.0, position: [0.6, 1.5, 1.4], hold: 0 }] })"""
    )
    page.set(2.0)


def clips(page: Page) -> None:
    """The clip library, and a clip of it that is played."""
    page.page.click("#tab-clips")
    page.page.fill("#clip-words", "dance")
    page.page.wait_for_selector("#clip-charleston")
    page.page.click("#clip-charleston")
    page.until("studio.take.value.state === 'done' && studio.take.value.script[0].clip === 'charleston'")
    page.shown()
    page.until(
        "[...document.querySelectorAll('.clip canvas')].slice(0, 6).every((one) => one.getContext('2d')"
        ".getImageData(0, 0, one.width, one.height).data.some((value) => value > 0))"
    )
    page.set(1.0)


def export(page: Page) -> None:
    """The ways out."""
    page.set(0.5)
    page.page.click("#export")


def apparel(page: Page) -> None:
    """Learned apparel with its dial."""
    page.page.click("#sample-dancer")
    page.until("studio.character.value?.name === 'dancer' && studio.character.value.state === 'ready'")
    page.until("studio.take.value && studio.take.value.state === 'done'")
    page.shown()
    page.type("a person dances and turns around")
    page.page.click("#body > summary")
    page.page.select_option("#apparel", "learn")
    page.page.click("#dress")
    page.until("studio.take.value.how === 'dress' && studio.take.value.state === 'done'")
    page.shown()
    page.set(1.2)


def paint(page: Page) -> None:
    """The mask of the dancer, some of it wiped off with the brush."""
    page.page.click("#sample-dancer")
    page.until("studio.character.value?.name === 'dancer' && studio.character.value.state === 'ready'")
    page.until("studio.character.value.laid && studio.take.value?.state === 'done'")
    page.page.click("#body > summary")
    page.page.click("#paint")
    page.until("document.getElementById('dab')")
    page.page.select_option("#brush", "remove")
    x, y = page.page.evaluate(AIM, [0.1, 0.65, 0.2])  # on the skirt
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 40, y + 10, steps=4)
    page.page.mouse.up()
    page.until("studio.character.value.painted")


def chains(page: Page) -> None:
    """Chains over what was painted, swinging."""
    paint(page)
    page.page.click("#painted")
    page.until("studio.character.value.chains?.length")
    page.page.select_option("#colouring", "chains")
    page.page.click("#live")
    page.until("studio.view().panes[0].model.springs")
    page.set(0.6)
    page.page.click("#shake")
    page.page.wait_for_timeout(700)


def live(page: Page) -> None:
    """A character that never stops and looks at the mouse."""
    page.page.click("#sample-person")
    page.until("studio.character.value?.name === 'person' && studio.take.value?.state === 'done'")
    page.shown()
    page.page.click("#go-live")
    page.until("studio.stream()?.clip.frames > 0")
    page.page.fill("#sentence", "waves with the right hand")
    page.page.press("#sentence", "Enter")
    page.page.mouse.move(820, 180)
    page.page.wait_for_timeout(2500)
    page.page.fill("#sentence", "jumps over a puddle")


STATES = {  # those of a first visit before those that leave something behind
    "first": (first, False, 1280),
    "dark": (first, True, 1280),
    "narrow": (first, False, 390),
    "sentence": (sentence, False, 1280),
    "narrow-dark": (sentence, True, 390),
    "handles": (handles, True, 1280),
    "export": (export, True, 1280),
    "clips": (clips, False, 1280),
    "apparel": (apparel, False, 1280),
    "paint": (paint, False, 1280),
    "chains": (chains, False, 1280),
    "takes": (takes, False, 1280),
    "directing": (directing, False, 1280),
    "live": (live, False, 1280),
}
"""What is done, whether it is dark, and how wide the window is."""


def main(names: list[str]) -> None:
    """Make them all, or those that are named."""
    OUT.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        studio = Studio(Path(folder) / "studio")
        try:
            for name in names or STATES:
                act, dark, width = STATES[name]
                for project in studio.get("/api/about")["projects"]:
                    studio.ask("DELETE", f"/api/projects/{project['id']}")
                height = 844 if width < 720 else 800
                with Page(browser, studio, width=width, height=height, dark=dark, scale=1) as page:
                    page.ready()
                    act(page)
                    shot(page, name)
        finally:
            studio.stop()


if __name__ == "__main__":
    main(sys.argv[1:])
