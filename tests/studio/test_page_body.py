"""A body corrected by hand, in a real browser: joints are dragged, parts get another kind, and all of it follows."""

import time

import pytest
from browser import AIM, CHROMIUM, ROOT, VITE, page_of

pytest.importorskip("playwright", reason="the page is tested with playwright: make browser")
if CHROMIUM is None or not VITE.exists():
    pytest.skip("there is no Chromium, or the page's tools are not installed", allow_module_level=True)

from test_page import AXE, SMALL

SAID = "studio.character.value.body.said"
READY = "studio.character.value.state === 'ready'"


@pytest.fixture
def page(tmp_path):
    with page_of(tmp_path, "robot") as page:
        yield page


def test_a_joint_is_dragged_and_a_part_gets_another_kind(page):
    page.page.click("#body > summary")
    page.page.click("#correct")
    page.until("studio.view().placed && studio.view().panes[0]?.bound")
    page.value("studio.view().draw(true)")
    knee = page.value("studio.character.value.body.joints.find((one) => one.name === 'left_knee').point")
    before, first = page.value(SAID), page.value("studio.take.value.id")
    eye = page.value("studio.view().camera.position.toArray()")
    x, y = page.page.evaluate(AIM, knee)
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x, y - 12, steps=3)
    start = time.monotonic()
    page.page.mouse.up()
    page.until(f"{SAID}.joints.left_knee && {READY}")
    print(f"a joint was dragged: everything followed in {time.monotonic() - start:.2f} s")
    said = page.value(SAID)["joints"]
    assert said["left_knee"][1] > knee[1] + 0.01
    assert said["right_knee"] == [-said["left_knee"][0], *said["left_knee"][1:]]
    page.until("studio.view().panes[0].model.key.split(':')[1] === String(studio.character.value.version)")
    assert page.value("studio.view().camera.position.toArray()") == pytest.approx(eye)  # nothing turned meanwhile

    page.page.select_option("#joint", "head")
    page.page.fill("[aria-label=head] input >> nth=1", "1.3")  # and by the keyboard
    page.page.press("[aria-label=head] input >> nth=1", "Tab")
    page.until(f"{SAID}.joints.head?.[1] === 1.3 && {READY}")
    page.page.select_option(".painting .field.small select >> nth=1", "prop")
    page.until(f"{SAID}.part.length === 1 && {SAID}.part[0].kind === 'prop' && {READY}")
    count = page.value("studio.character.value.body.parts.concat(studio.character.value.dress ?? []).length")
    page.page.select_option("#all-parts", "body")
    page.until(f"{SAID}.part.length === 1 && {SAID}.part[0].kind === 'body' && {READY}")
    assert page.value(f"{SAID}.part[0].at.length") == count
    assert page.value(SMALL) == []
    page.value((ROOT / "studio" / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8"))
    assert page.value(AXE) == []

    undone = f"{SAID}.part[0].kind === 'prop'", f"{SAID}.part.length === 0", f"!{SAID}.joints.head"
    for left in (*undone, f"!{SAID}.joints.left_knee"):
        page.page.click("[aria-label=undo]")
        page.until(f"{left} && {READY}")
    page.until(f"JSON.stringify({SAID}.joints) === '{{}}' && {SAID}.part.length === 0 && {READY}")
    assert page.value(SAID) == before
    page.page.click("#corrected")
    page.until(f"studio.take.value.id !== '{first}' && studio.take.value.state === 'done'")
