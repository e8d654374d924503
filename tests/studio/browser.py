"""Chromium without a window, and a page of the studio in it."""

import base64
import contextlib
import functools
import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
]  # fmt: skip
SECONDS = 90  # that one wait may take: a browser without a GPU, on a machine that does much else
SCALE = 0.5  # pixels drawn for each of the page: without a GPU they are what takes the time


VITE = ROOT / "studio" / "node_modules" / ".bin" / "vite"
"""Builds the page; `npm ci` in studio/ brings it."""


@functools.cache
def checked_build():
    """The page's scripts with `studio/src/checks.ts`, by which tests look into it; what is shipped has none of that."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [str(VITE), "build", "--mode", "checked", "--outDir", folder, "--logLevel", "error"],
            cwd=ROOT / "studio", check=True,
        )  # fmt: skip
        return {path.name: path.read_bytes() for path in Path(folder).glob("*.js")}


def serve_checked(context):
    """Let a browser's context get the page's scripts from `checked_build`."""
    scripts = checked_build()

    def answer(route):
        name = route.request.url.split("?")[0].rpartition("/")[2]
        route.fulfill(body=scripts[name], content_type="text/javascript") if name in scripts else route.continue_()

    context.route(re.compile(r"/[\w.-]+\.js(\?.*)?$"), answer)


@contextlib.contextmanager
def chromium():
    """A browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


AIM = """([x, y, z]) => {
    const view = studio.view();
    const spot = view.camera.position.clone().set(x, y, z).project(view.camera);
    const box = view.canvas.getBoundingClientRect();
    return [box.left + (spot.x + 1) / 2 * box.width, box.top + (1 - spot.y) / 2 * box.height];
}"""
"""Where on the page a place of the scene is seen."""


class Page:
    """A page of a studio, and what went wrong in it."""

    def __init__(self, browser, studio, width=1280, height=800, dark=False, path="", scale=SCALE):
        self.studio = studio
        self.context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light",
            reduced_motion="reduce", accept_downloads=True, device_scale_factor=scale,
        )  # fmt: skip
        self.context.set_default_timeout(SECONDS * 1000)
        serve_checked(self.context)
        self.wrong, self.abroad = [], []
        try:
            self.page = self.context.new_page()
            self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
            self.page.on("console", lambda said: self.wrong.append(said.text) if said.type == "error" else None)
            self.page.on("request", self._request)
            self.page.goto(studio.address.replace("/#", f"/#{path}&" if path else "/#"))
        except BaseException:
            self.context.close()  # or it would go on drawing beside those that come after it
            raise

    def _request(self, request):
        if not request.url.startswith((self.studio.base, "blob:", "data:")):
            self.abroad.append(request.url)

    def value(self, expression):
        """What a JavaScript expression gives."""
        return self.page.evaluate(expression)

    def until(self, expression):
        """Wait until a JavaScript expression is true; the page's policy allows no other way."""
        end = time.monotonic() + SECONDS
        look = f"(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()"
        while not self.value(look):
            if time.monotonic() > end:
                state = self.value(
                    "window.studio && JSON.stringify([studio.notice.value, studio.take.value, studio.character.value])"
                )
                raise AssertionError(f"{expression} did not become true; {str(state)[:2000]}; {self.wrong}")
            time.sleep(0.05)

    def ready(self):
        """Wait until a character is shown with a take that is done."""
        self.until("window.studio && studio.view() && studio.take.value && studio.take.value.state === 'done'")
        self.shown()

    def shown(self):
        """Wait until the take that is chosen is the one that is drawn, and no more its draft."""
        self.until(
            "studio.view().panes.some((pane) => pane.clip && !pane.draft && pane.label === studio.take.value?.id)"
        )

    def reset(self, **doc):
        """Load the page anew, with the first character, its first take, and takes that are made quickly: nothing that
        was open, typed or chosen before is left, and what was made before is not shown.
        """
        self.page.reload()
        self.until("window.studio && studio.view() && studio.online.value")
        self.value(f"studio.fresh({json.dumps({'steps': 2, **doc})})")
        self.ready()

    def opened(self, name):
        """Wait until a character of a name is shown with a take that is done: it is animated by itself."""
        self.until(f"studio.character.value?.name === '{name}' && studio.character.value.state === 'ready'")
        self.until("studio.take.value && studio.take.value.state === 'done'")
        self.shown()

    def set(self, seconds):
        """Go to a time and draw."""
        self.value(f"studio.set({seconds})")

    def drop(self, *paths):
        """Drop files on the page."""
        files = [[Path(path).name, base64.b64encode(Path(path).read_bytes()).decode()] for path in paths]
        self.page.evaluate(
            """(files) => {
                const carried = new DataTransfer();
                for (const [name, data] of files) {
                    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
                    carried.items.add(new File([bytes], name));
                }
                const how = { dataTransfer: carried, bubbles: true, cancelable: true };
                document.body.dispatchEvent(new DragEvent("drop", how));
            }""",
            files,
        )

    def type(self, sentence):
        """Type a sentence, press Enter, and wait for the take."""
        before = self.value("studio.take.value?.id ?? ''")
        self.page.fill("#sentence", sentence)
        self.page.press("#sentence", "Enter")
        self.until(f"studio.take.value && studio.take.value.id !== '{before}' && studio.take.value.state === 'done'")
        self.shown()

    def check(self):
        """Nothing may have gone wrong, and nothing may have been asked of another machine."""
        wrong, abroad = list(self.wrong), list(self.abroad)
        self.wrong.clear()
        self.abroad.clear()
        assert wrong == [] and abroad == [], (wrong, abroad)

    def close(self):
        """Close it, however it stands."""
        self.context.close()

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        self.close()
        if kind is None:
            self.check()


@contextlib.contextmanager
def page_of(folder, sample, *size, **how):
    """The page of a studio of its own with a sample character that walks."""
    from studio_process import Studio

    studio = Studio(folder / "folder")
    try:
        one = studio.sample(sample)["id"]
        made = studio.wait(studio.animate(one, "walks", 1))
        with chromium() as browser, Page(browser, studio, *size, **how) as page:
            page.until("window.studio && studio.view() && studio.online.value")
            page.value(f"studio.change('', {{ character: '{one}', take: '{made['takes'][0]}' }})")
            page.shown()
            yield page
    finally:
        studio.stop()
