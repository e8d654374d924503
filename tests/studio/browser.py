"""Chromium without a window, and a page of the studio in it."""

import base64
import contextlib
import shutil
import time
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
]  # fmt: skip
SECONDS = 240  # that anything may take: a browser without a GPU, on a machine that does much else


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


class Page:
    """A page of a studio, and what went wrong in it."""

    def __init__(self, browser, studio, width=1280, height=800, dark=False, path=""):
        self.studio = studio
        self.context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light",
            reduced_motion="reduce", accept_downloads=True,
        )  # fmt: skip
        self.page = self.context.new_page()
        self.wrong, self.abroad = [], []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("console", lambda said: self.wrong.append(said.text) if said.type == "error" else None)
        self.page.on("request", self._request)
        self.page.goto(studio.address.replace("/#", f"/#{path}&" if path else "/#"))

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
                state = self.value("JSON.stringify([studio.notice.value, studio.take.value, studio.character.value])")
                raise AssertionError(f"{expression} did not become true; {state[:2000]}; {self.wrong}")
            time.sleep(0.05)

    def ready(self):
        """Wait until a character is shown with a take that is done."""
        self.until("window.studio && studio.view() && studio.take.value && studio.take.value.state === 'done'")
        self.shown()

    def shown(self):
        """Wait until the take that is chosen is the one that is drawn."""
        self.until("studio.view().panes.some((pane) => pane.clip && pane.label === studio.take.value?.id)")

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

    def close(self):
        """Close it; nothing may have gone wrong, and nothing may have been asked of another machine."""
        self.context.close()
        assert self.wrong == [] and self.abroad == []
