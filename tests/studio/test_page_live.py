"""A character that never stops, in a real browser: told, steered, looked at, kept."""

import pytest
from browser import CHROMIUM, ROOT, VITE, page_of

pytest.importorskip("playwright", reason="the page is tested with playwright: make browser")
if CHROMIUM is None or not VITE.exists():
    pytest.skip("there is no Chromium, or the page's tools are not installed", allow_module_level=True)

from test_page import AXE, SMALL

ASIDE = """(() => {
    const view = studio.view();
    const head = view.panes[0].model.bones[15];
    const ahead = view.camera.position.clone().set(0, 0, 1).applyQuaternion(head.quaternion);
    ahead.applyQuaternion(head.parent.getWorldQuaternion(head.quaternion.clone()));
    return ahead.dot(view.camera.position.clone().set(1, 0, 0).applyQuaternion(view.camera.quaternion));
})()"""
"""How far the head looks to the right side of the picture."""
PLACE = "studio.view().panes[0].model.bones[0].position.toArray()"


@pytest.fixture
def page(tmp_path):
    # few pixels, for a browser without a GPU to draw as often as it would with one
    with page_of(tmp_path, "person", 800, 500, scale=0.25) as page:
        yield page


def test_it_does_what_it_is_told_looks_at_the_mouse_and_is_kept(page):
    page.page.click("#go-live")
    page.until("studio.stream().clip.frames > 0")
    page.page.fill("#sentence", "waves with the right hand")
    page.page.press("#sentence", "Enter")
    assert page.page.input_value("#sentence") == ""
    page.until("studio.stream().waited > 0")
    print(f"from Enter to the first changed frame: {page.value('studio.stream().waited'):.0f} ms")

    page.page.mouse.move(100, 150)
    page.until(f"{ASIDE} < -0.65")
    page.page.mouse.move(620, 150)
    page.until(f"{ASIDE} > -0.1")

    page.page.keyboard.press("2")  # still in the sentence: it is typed
    assert page.page.input_value("#sentence") == "2"
    page.page.fill("#sentence", "")
    page.page.keyboard.press("Escape")
    page.page.keyboard.press("2")
    assert "Now: jumps" in page.page.inner_text(".understood")
    page.until("studio.stream().said.includes('jumps')")

    page.page.keyboard.down("d")  # to the right, as it is seen
    for _ in range(2):  # it lands from its jump and turns while it goes the first steps
        x, _, z = page.value(PLACE)
        page.until(f"Math.hypot({PLACE}[0] - {x}, {PLACE}[2] - {z}) > 0.8")
    right = page.value(
        "studio.view().camera.position.clone().set(1, 0, 0).applyQuaternion(studio.view().camera.quaternion)"
    )
    there, _, deep = page.value(PLACE)
    assert (there - x) * right["x"] + (deep - z) * right["z"] > 0.4
    page.page.keyboard.up("d")
    page.until("document.querySelector('.understood').textContent.includes('Now: stands still')")

    assert page.value(SMALL) == []
    page.value((ROOT / "studio" / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8"))
    assert page.value(AXE) == []

    page.page.click("[aria-label='change what 1 plays']")
    page.page.fill("input.keyed", "bows")
    page.page.press("input.keyed", "Enter")
    page.page.click(".play-key:has-text('bows')")
    assert "Now: bows" in page.page.inner_text(".understood")
    page.until("studio.stream().said.includes('bows')")

    page.page.click("#live-end")
    page.until("studio.take.value.how === 'live' && studio.take.value.state === 'done'")
    page.shown()
    assert page.value("studio.take.value.seconds") > 1
    assert page.page.inner_text(".block").startswith("waves with the right hand; jumps; walks forward; bows")
    page.page.click("[aria-label=undo]")
    page.until("studio.take.value?.how === 'animate'")
