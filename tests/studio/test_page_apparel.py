"""Hair and clothes in the page, in a real browser: painted, taken back, swinging live, dressed on chains."""

import math

import pytest
from browser import AIM, CHROMIUM, VITE, Page, chromium
from studio_process import Studio

pytest.importorskip("playwright", reason="the page is tested with playwright: make browser")
if CHROMIUM is None or not VITE.exists():
    pytest.skip("there is no Chromium, or the page's tools are not installed", allow_module_level=True)

LEGEND = "document.querySelector('.painting legend').textContent"
TIP = """(() => {
    const { bones } = studio.view().panes[0].model;
    return bones.at(-1).getWorldPosition(bones[0].position.clone()).toArray();
})()"""


SEEN = """(kind) => {
    const view = studio.view();
    const { worn } = studio.numbered.value;
    const own = studio.character.value.dress.map((part, number) => (part.kind === kind ? number + 1 : 0));
    const chosen = worn.numbers.findIndex((number) => number && own.includes(number));
    const [name, rows] = [...worn.rows].find(([, vertices]) => vertices.includes(chosen));
    const skin = [...view.panes[0].model.primitives].find(([, key]) => key === name)[0];
    const colour = skin.geometry.getAttribute("color");
    const row = rows.indexOf(chosen);
    return [colour.getX(row), colour.getY(row), colour.getZ(row)].map((value) => Number(value.toFixed(3)));
}"""
"""The colour in which a part of a kind is drawn."""


@pytest.fixture(scope="module")
def dancer(tmp_path_factory):
    """A page with the dancer, a take of it in it, and its id."""
    studio = Studio(tmp_path_factory.mktemp("apparel") / "folder")
    try:
        one = studio.sample("dancer")["id"]
        made = studio.wait(studio.animate(one, "walks", 1))
        studio.until(lambda: "laid" in studio.get(f"/api/characters/{one}"), "a look for chains")
        with chromium() as browser, Page(browser, studio) as page:
            page.until("window.studio && studio.view() && studio.online.value")
            page.value(f"studio.change('', {{ character: '{one}', take: '{made['takes'][0]}' }})")
            page.shown()
            page.page.click("#body > summary")
            yield page, one
    finally:
        studio.stop()


def test_hair_and_clothes_are_painted_and_swing(dancer):
    page, one = dancer
    record = f"/api/characters/{one}"
    page.page.click("#paint")
    page.until("document.getElementById('dab')")
    before, laid = page.value(LEGEND), page.studio.get(record)["laid"]

    page.page.select_option("#brush", "remove")  # a stroke over the skirt, and one by a key in the middle of the view
    chains = page.studio.get(record)["chains"]
    skirt = [chain["points"][len(chain["points"]) // 2] for chain in chains if chain["kind"] == "skirt"]
    eye = page.value("studio.view().camera.position.toArray()")
    nearest = sorted(skirt, key=lambda point: math.dist(point, eye))[: len(skirt) // 2]
    first, *others = sorted(page.page.evaluate(AIM, point) for point in nearest)
    page.page.mouse.move(*first)
    page.page.mouse.down()
    for spot in others:
        page.page.mouse.move(*spot, steps=4)
    page.page.mouse.up()
    page.until(f"studio.character.value.painted && {LEGEND} !== '{before}'")
    page.page.keyboard.press("Control+z")
    page.until(f"!studio.character.value.painted && {LEGEND} === '{before}'")
    page.page.keyboard.press("Control+Shift+z")
    page.until(f"studio.character.value.painted && {LEGEND} !== '{before}'")
    stroke = page.value(LEGEND)
    page.value("(() => { const d = document.getElementById('brush-size'); d.value = '0.2'; "
               "d.dispatchEvent(new Event('input', { bubbles: true })); })()")  # fmt: skip
    page.page.locator(".stage canvas").hover()
    page.page.click("#painted", trial=True)
    page.page.keyboard.press("x")
    page.until(f"{LEGEND} !== '{stroke}'")
    page.page.keyboard.press("Control+z")
    page.until(f"{LEGEND} === '{stroke}'")
    page.page.click("#painted")

    page.studio.until(lambda: page.studio.get(record)["laid"] > laid, "chains over what was painted")
    page.until("studio.character.value.chains.length")
    page.page.select_option("#colouring", "chains")
    page.page.click("#live")
    page.until("studio.view().panes[0].model.springs")
    page.set(0.5)
    page.until(f"{TIP}.every(Number.isFinite)")
    still = page.value(TIP)
    page.page.keyboard.press("k")
    page.until(f"Math.abs({TIP}[0] - {still[0]}) > 0.05")
    page.page.select_option("#apparel", "chains")
    page.page.click("#live")
    page.page.click("#dress")
    page.until("studio.take.value.how === 'dress' && studio.take.value.state === 'done'")
    page.shown()
    assert page.value("[studio.take.value.worn, studio.take.value.stiffness, studio.take.value.gravity]") == [
        "chains", 1, 1,
    ]  # fmt: skip
    page.page.click("#paint")
    page.page.click("#as-found")
    page.until(f"!studio.character.value.painted && {LEGEND} === '{before}'")
    page.page.keyboard.press("Escape")
    page.until("!document.getElementById('dab')")
    page.check()


def test_a_click_gives_a_part_another_kind_and_all_follows(dancer):
    page, one = dancer
    record = f"/api/characters/{one}"
    kinds = "studio.character.value.dress.map((part) => part.kind)"
    assert "skirt" in page.value(kinds)
    page.page.click("#correct")
    page.until("studio.numbered.value && studio.view().panes[0]?.bound")
    page.value("studio.view().draw(true)")
    assert "% skirt" in page.value("document.querySelector('.kinds').textContent")
    skirt = page.page.evaluate(SEEN, "skirt")
    assert skirt != page.page.evaluate(SEEN, "hair")

    chains = page.studio.get(record)["chains"]
    points = [chain["points"][len(chain["points"]) // 2] for chain in chains if chain["kind"] == "skirt"]
    eye = page.value("studio.view().camera.position.toArray()")
    page.page.mouse.click(*page.page.evaluate(AIM, min(points, key=lambda point: math.dist(point, eye))))
    page.until("document.querySelector('.picked')")
    assert page.value("document.querySelector('.picked p').textContent").strip().startswith("skirt")
    before, laid = page.value("studio.character.value.version"), page.studio.get(record)["laid"]
    page.page.click(".picked button >> text=accessory")
    page.until(f"!{kinds}.includes('skirt') && studio.character.value.version > {before}")
    page.until("studio.numbered.value.key.endsWith(JSON.stringify(studio.character.value.dress))")
    page.until("studio.view().panes[0].model.key.split(':')[1] === String(studio.character.value.version)")
    assert page.page.evaluate(SEEN, "accessory") != skirt
    page.studio.until(lambda: page.studio.get(record)["laid"] > laid, "chains over what hangs now")
    assert all(chain["kind"] != "skirt" for chain in page.studio.get(record)["chains"])  # what is worn is stiff
    page.page.click("[aria-label=undo]")
    page.until(f"{kinds}.includes('skirt') && studio.character.value.state === 'ready'")
    page.page.click("#corrected")
    page.check()
