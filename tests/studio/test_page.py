"""The page in a real browser: the first minute, takes, directing, downloads, pictures."""

import base64
import gzip
import importlib.util
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from browser import AIM, CHROMIUM, ROOT, SECONDS, VITE, Page, chromium
from scipy.spatial import cKDTree
from studio_process import Studio

from bunraku import load_character, save_character
from bunraku.anatomy.anatomy import Anatomy
from bunraku.files.clips import load_clip_animation
from bunraku.files.samples import sample_character
from bunraku.generation.candidates import GUIDANCE
from bunraku.render import kernels
from bunraku.render.stage import Camera
from bunraku.retarget.pins import end_positions, limb_ends
from bunraku.studio.wire import load_handles, load_take

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium; on Debian: apt-get install chromium"),
    pytest.mark.skipif(
        importlib.util.find_spec("playwright") is None, reason="playwright is not installed: pip install playwright"
    ),
    pytest.mark.skipif(not VITE.exists(), reason="the page cannot be built: npm ci in studio/"),
]
DATA = Path(os.environ.get("BUNRAKU_DATA", "runs/data"))
FILES = Path(__file__).parents[1] / "files" / "data"


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A studio of these tests' own: what others left in theirs would be opened here."""
    one = Studio(tmp_path_factory.mktemp("page") / "folder")
    yield one
    one.stop()


@pytest.fixture(scope="module")
def shared(browser, studio):
    """One page for all tests: loading it costs a browser without a graphics card more than most of them."""
    with Page(browser, studio) as one:
        one.ready()
        yield one


@pytest.fixture
def page(shared):
    """The page as it was at first, a sentence of a second in it, which is quickly made."""
    shared.reset(script=[{"text": "walks", "seconds": 1}])
    yield shared
    shared.page.set_viewport_size({"width": 1280, "height": 800})
    shared.check()


def test_a_character_moves_before_anybody_does_anything(page):
    pictures = []
    for moment in (0.1, 0.6):
        page.set(moment)
        pictures.append(page.value("studio.view().canvas.toDataURL()"))
    assert pictures[0] != pictures[1]
    assert page.page.title() == "Bunraku studio"


def test_words_that_are_not_understood_are_underlined_and_a_chip_mends_them(page):
    page.page.fill("#sentence", "walks forward zorply")
    page.page.wait_for_selector(".backdrop u")
    assert page.page.inner_text(".backdrop u") == "zorply" and "zorply" in page.page.inner_text("#understood")
    page.page.click("#understood .chip")
    assert "zorply" not in page.page.input_value("#sentence")
    page.page.keyboard.press("Escape")
    page.page.keyboard.press("Control+z")
    assert page.page.input_value("#sentence") == "walks forward zorply"


def test_a_sentence_four_takes_and_undo(page):
    before = page.value("studio.takes.value.length")
    page.page.click("text=four takes")
    page.type("jumps high")
    page.until(f"studio.takes.value.filter((one) => one.state === 'done').length >= {before + 4}")
    seeds = page.value("studio.takes.value.slice(0, 4).map((one) => one.seed).sort()")
    assert seeds == [0, 1, 2, 3]
    page.until("studio.view().panes.length === 4")
    page.set(0.5)
    page.page.keyboard.press("Escape")
    page.page.click("#compare")
    page.until("studio.view().panes.length === 1")
    page.page.click(".takes li:first-child .icon >> nth=0")
    page.until("studio.takes.value.some((one) => one.star)")
    page.page.click("[aria-label=undo]")  # the star
    page.until("studio.takes.value.every((one) => !one.star)")
    page.page.click("[aria-label=undo]")  # the takes
    page.until(f"studio.takes.value.length === {before}")
    page.page.click("[aria-label=redo]")
    page.until(f"studio.takes.value.length === {before + 4}")


def test_a_sequence_in_the_box_makes_three_parts(page):
    page.type("walks:1; jumps:0.5; waves:0.5")
    assert page.value("studio.doc.value.script.map((one) => [one.text, one.seconds])") == [
        ["walks", 1], ["jumps", 0.5], ["waves", 0.5],
    ]  # fmt: skip
    assert page.page.locator(".block").count() == 3 and page.page.input_value("#sentence") == "walks"
    assert page.value("studio.take.value.seconds") == 2


def test_an_empty_and_a_long_sentence_are_answered_in_words_of_the_page(page):
    before = page.value("studio.takes.value.length")
    for text, said in (("", "type what the character does"), ("walks " * 200, "1,200 letters, at most 1,000")):
        page.page.fill("#sentence", text)
        assert page.page.input_value("#sentence") == text  # nothing is cut off
        page.page.press("#sentence", "Enter")
        page.until("studio.notice.value?.bad")
        assert said in page.page.inner_text("[role=alert]")
        page.value("studio.notice.value = null")
    assert page.value("studio.takes.value.length") == before


def test_the_export_dialog_closes_and_gives_the_focus_back(page):
    for close in (
        lambda: page.page.keyboard.press("Escape"),
        lambda: page.page.click("dialog button:text('Cancel')"),
        lambda: page.page.mouse.click(5, 400),  # beside it
    ):
        page.page.click("#export")
        page.page.click("dialog.export h2")  # a press inside leaves it open
        assert page.page.locator("dialog.export").count() == 1
        close()
        page.until("!document.querySelector('dialog.export') && document.activeElement.id === 'export'")


def test_what_is_shipped_asks_for_the_token_and_holds_nothing_of_tests(browser, studio):
    context = browser.new_context()
    try:
        page = context.new_page()
        page.set_default_timeout(SECONDS * 1000)
        page.goto(f"{studio.base}/")
        page.wait_for_selector(".lock")
        assert "bunraku studio" in page.inner_text(".lock")
        page.goto(studio.address)
        page.reload()  # another hash alone is the same page
        page.wait_for_selector(".takes li.chosen")
        assert page.evaluate("typeof window.studio") == "undefined"
    finally:
        context.close()
    for path in (ROOT / "src" / "bunraku" / "studio" / "static").glob("*.js"):
        assert b"silhouette" not in path.read_bytes() and b"window.studio" not in path.read_bytes()


def test_a_clip_is_found_moves_and_is_played(page):
    page.page.click("#tab-clips")
    page.page.fill("#clip-words", "applauds")
    page.page.wait_for_selector("#clip-clap")
    page.until(f"({DRAWN})('clap')")
    page.page.click("#clip-clap")
    page.until("studio.take.value.state === 'done' && studio.take.value.script[0].clip === 'clap'")
    page.shown()
    assert page.page.inner_text(".block").startswith("▶ clap")
    assert page.page.input_value("#sentence") == page.value("studio.take.value.script[0].text")
    page.page.fill("#sentence", "claps twice")  # typed over, it is a sentence
    assert page.value("studio.doc.value.script") == [{"text": "claps twice", "seconds": 4.45}]


DRAWN = """(name) => {
    const canvas = document.querySelector(`#clip-${name} canvas`);
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return data.some((one, place) => place % 4 === 3 && one > 200);
}"""
"""Whether the card of a clip shows it, and no more the faint character that stands there before."""


def test_words_that_are_typed_before_the_library_is_there_find_what_they_say(page):
    held = []
    page.page.route("**/api/clips", lambda route: held.append(route))
    try:
        page.page.click("#tab-clips")
        page.page.fill("#clip-words", "applauds")
        page.page.wait_for_selector("#clip-clap")
        found = page.page.locator(".clip").count()
        held[0].continue_()
        page.page.wait_for_selector("#clip-words[placeholder^='search 2']")
        assert page.page.locator(".clip").count() == found < 100
    finally:
        page.page.unroute("**/api/clips")


def test_clips_are_dragged_and_added_onto_the_timeline(page):
    page.page.click("#tab-clips")
    page.page.fill("#clip-words", "bow")
    page.page.wait_for_selector("#clip-bow")
    row = page.page.locator(".row.sentences")
    box = row.bounding_box()
    page.page.locator(".clip:has(#clip-bow)").drag_to(row, target_position={"x": 5, "y": box["height"] / 2})
    page.until("studio.doc.value.script.length === 2")
    assert page.value("studio.doc.value.script.map((one) => one.clip ?? one.text)") == ["bow", "walks"]
    page.page.fill("#clip-words", "salute")
    page.page.click("[aria-label='add salute to the timeline']")
    assert page.value("studio.doc.value.script.map((one) => one.clip ?? one.text)") == ["bow", "walks", "salute"]
    before = page.value("studio.take.value.id")
    page.page.click("#animate")
    page.until(f"studio.take.value.id !== '{before}' && studio.take.value.state === 'done'")
    seconds = page.value("studio.doc.value.script.reduce((sum, one) => sum + one.seconds, 0)")
    assert page.value("studio.take.value.seconds") == pytest.approx(seconds, abs=0.1)


def test_typed_words_suggest_clips(page):
    page.page.fill("#sentence", "somebody strums the strings of a guitar")
    page.page.wait_for_selector("#understood .chip:has-text('guitar')")
    page.page.click("#understood .chip:has-text('guitar')")
    page.until("studio.take.value.state === 'done' && studio.take.value.script[0].clip === 'guitar'")


def test_a_take_is_mirrored_and_cut(page):
    page.page.click("summary:has-text('change this take')")
    take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    before = take_of(page.studio, owner, take).motion
    page.page.click("#mirror")
    page.until("studio.take.value.how === 'mirror' && studio.take.value.state === 'done'")
    mirrored = take_of(page.studio, owner, page.value("studio.take.value.id")).motion
    assert len(mirrored) == len(before) and np.abs(mirrored.rotations - before.rotations).max() > 0.05
    page.page.fill("label:has-text('from') input", "0.5")
    page.page.press("label:has-text('from') input", "Tab")
    page.page.fill("label:has-text('to') input", "0.9")
    page.page.press("label:has-text('to') input", "Tab")
    page.page.click("#trim")
    page.until("studio.take.value.how === 'trim' && studio.take.value.state === 'done'")
    cut = take_of(page.studio, owner, page.value("studio.take.value.id")).motion
    np.testing.assert_array_equal(cut.rotations, mirrored.rotations[10:18])


def test_a_hand_is_pinned_and_a_path_is_typed_without_a_pointer(page):
    page.set(0.2)  # the take that is open may be a short one
    page.page.click("summary:has-text('change this take')")
    page.page.focus("button:text('pin left hand here')")
    page.page.keyboard.press("Enter")
    (pin,) = page.value("studio.doc.value.pins")
    assert pin["part"] == "left_hand" and pin["time"] == 0.2
    page.page.fill(".pin input >> nth=1", str(round(pin["position"][1] + 0.05, 2)))
    page.page.press(".pin input >> nth=1", "Tab")
    page.page.focus("button:text('Bend to the pins')")
    page.page.keyboard.press("Enter")
    page.until("studio.take.value.how === 'bend' && studio.take.value.state === 'done'")
    page.page.click("#fold")
    page.page.click("#draw")
    page.page.fill("#path", "0,0 0,1 1,2")
    page.page.press("#path", "Enter")
    assert page.value("studio.doc.value.path") == [[0, 0], [0, 1], [1, 2]]


def vase(rings=24, sides=24):
    """An OBJ of a body that is the same from all sides, far from the origin, whose front nobody can be sure of."""
    radii = 0.3 + 0.15 * np.sin(np.linspace(0, 6, rings))
    radii[[0, -1]] = 0.01
    angles = np.arange(sides) / sides * 2 * np.pi
    lines = [
        f"v {radius * np.cos(angle) - 48:f} {high:f} {radius * np.sin(angle) - 139:f}"
        for radius, high in zip(radii, np.linspace(0, 1.6, rings), strict=True)
        for angle in angles
    ]
    for ring in range(rings - 1):
        for side in range(sides):
            one, other = ring * sides + side + 1, ring * sides + (side + 1) % sides + 1
            lines.append(f"f {one} {one + sides} {other + sides} {other}")
    return "\n".join(lines)


def test_four_views_ask_for_the_front(page, tmp_path):
    (tmp_path / "vase.obj").write_text(vase())
    page.drop(tmp_path / "vase.obj")
    page.until("studio.character.value?.name === 'vase' && studio.character.value.state === 'ready'")
    axes = page.value("studio.character.value.axes")
    page.page.wait_for_selector(".fronts .card >> nth=3")
    page.page.click(".fronts .card >> nth=1")  # while its first take is made
    page.until("studio.character.value.settings.front !== 'auto' && studio.character.value.state === 'ready'")
    wanted = {"+z": "+x", "+x": "-z", "-z": "-x", "-x": "+z"}[axes["front"]]
    assert page.value("[studio.character.value.settings.up, studio.character.value.settings.front]") == ["+y", wanted]
    page.until("studio.character.value.state === 'ready' && studio.take.value?.state === 'done'")
    page.shown()
    root = "studio.view().panes[0].model.bones[0].matrixWorld.elements.slice(12, 15)"
    x, y = page.value(f"(studio.view().draw(true), ({AIM})({root}))")  # at once: the take plays on, and begins anew
    assert 300 < x < 980 and 60 < y < 560, (x, y)  # it is in view
    page.page.click("[aria-label='delete vase']")
    page.until("studio.character.value?.name !== 'vase'")


SMALL = """[...document.querySelectorAll('button, input, select, summary, a, [role=slider]')].map((one) => {
    const { width, height } = one.getBoundingClientRect();
    return width > 0 && (width < 24 || height < 24) ? `${one.outerHTML.slice(0, 80)} ${width} x ${height}` : '';
}).filter((one) => one)"""
"""Targets under 24 pixels."""
AXE = """axe.run(document, { runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'] })
    .then((all) => all.violations.map((one) => [one.id, one.nodes.map((node) => node.html.slice(0, 120))]))"""


def states(page):
    """Go through what can be shown, giving the name of each."""
    yield "first"
    page.page.click("#fold")
    page.page.click("summary:has-text('change this take')")
    page.page.click("summary:has-text('how takes are drawn')")
    page.page.click("#body > summary")
    page.page.click("summary:has-text('how it stands')")
    page.set(0.3)
    page.page.click("button:text('pin left hand here')")
    page.page.click("text=Pin this pose")
    page.value("studio.change('', { span: [0.2, 0.6], path: [[0, 0], [0, 1]] })")
    yield "directing"
    page.page.click("#tab-clips")
    page.page.fill("#clip-words", "wave")
    page.page.wait_for_selector("#clip-wave")
    page.page.focus("#clip-wave")
    yield "clips"
    page.page.click("#tab-characters")
    page.page.click("#export")
    yield "export"
    page.page.keyboard.press("Escape")
    page.page.click("[aria-label=keys]")
    yield "keys"
    page.page.click("dialog button:text('Close')")
    page.page.click("#fold")


def sheets(page):
    """Go through the sheets of a phone, giving the name of each."""
    yield "first"
    for name in ("characters", "clips", "takes", "time"):
        page.page.click(f"#sheet-{name}")
        if name == "clips":
            page.page.wait_for_selector("#clip-wave")
        yield name
        page.page.click(f"#sheet-{name}")


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_small_and_axe_finds_nothing(page, width):
    axe = (ROOT / "studio" / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")
    page.page.set_viewport_size({"width": width, "height": 800})
    for name in states(page) if width > 720 else sheets(page):
        assert page.value(SMALL) == [], name
        page.value(axe)
        assert page.value(AXE) == [], name


SCROLLED = """async (selector) => {
    const list = document.querySelector(selector);
    const wrong = [];
    for (let at = 0; at < 160; at += 5) {
        list.scrollTop = at;
        const all = await axe.run(document, { runOnly: { type: 'rule', values: ['target-size'] } });
        wrong.push(...all.violations.flatMap((one) => one.nodes.map((node) => [at, node.html.slice(0, 120)])));
    }
    return [list.scrollTop, wrong];
}"""
"""How far a list was scrolled at last, and the targets of the page that axe found small on the way there."""


def test_nothing_that_stands_still_lies_on_what_is_scrolled(page):
    axe = (ROOT / "studio" / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")
    page.page.click("#tab-clips")
    page.page.wait_for_selector("#clip-wave")
    page.page.hover("#clip-wave")  # its credit is shown
    page.page.wait_for_selector(".credit")
    page.value(axe)
    assert page.page.evaluate(SCROLLED, "#side .panel") == [155, []]


def test_a_phone_shows_what_opens_and_what_animates_at_once(page):
    page.page.set_viewport_size({"width": 390, "height": 800})
    page.until("innerWidth === 390")
    for name in ("#open", "#sentence", "#animate", ".stage canvas", "#sheet-takes"):
        box = page.page.locator(name).bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= 800, name
    assert page.value("document.documentElement.scrollHeight") <= 800  # one screen
    on_top = "document.elementFromPoint(195, 300).closest('.stage, aside')?.className"
    assert page.value(on_top) == "stage"  # no sheet lies on it
    for name, there in (("characters", "left"), ("takes", "right"), ("takes", "stage")):
        page.page.click(f"#sheet-{name}")
        page.until(f"{on_top} === '{there}'")


def test_twelve_tabs_of_one_browser_are_served_and_each_has_its_view(shared):
    tabs = [shared.context.new_page() for _ in range(12)]
    try:
        for number, tab in enumerate(tabs):
            tab.set_viewport_size({"width": 480, "height": 360})  # without a GPU, pixels are what takes the time
            tab.goto(shared.studio.address)
            tab.wait_for_selector(".takes li.chosen", state="attached")  # so narrow a page has it in a sheet
            tab.evaluate(f"studio.change('', {{ seed: {700 + number} }})")
        shared.studio.until(
            lambda: (
                {700 + number for number in range(12)}
                <= {one["view"].get("seed") for one in shared.studio.get("/api/about")["projects"]}
            ),
            "twelve views",
        )
        tabs[3].reload()
        tabs[3].wait_for_selector(".takes li.chosen", state="attached")
        assert tabs[3].evaluate("studio.doc.value.seed") == 703
    finally:
        for tab in tabs:
            tab.close()


def stl(character, scale):
    """A binary STL, as a printer's program writes it: millimetres, +Z up."""
    corners = character.vertices[character.faces] @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32) * scale
    rows = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = corners
    return bytes(80) + struct.pack("<I", len(corners)) + rows.tobytes()


@pytest.mark.parametrize("kind", ["glb", "stl", "pmx", "vrm", "fbx"])
def test_characters_are_dropped(page, tmp_path, kind):
    path = tmp_path / f"dropped.{kind}"
    if kind == "glb":
        save_character(sample_character("robot"), path)
    elif kind == "stl":
        path.write_bytes(stl(sample_character("person"), 1000))
    elif kind == "fbx":
        path.write_bytes(gzip.decompress((FILES / "boxman_y_up_m.fbx.gz").read_bytes()))
    elif kind == "pmx":
        from bunraku.files.mmd.write import save_pmx
        from bunraku_lab.synthetic.wardrobe import wardrobe_character

        save_pmx(wardrobe_character(3), path)
    else:
        source = DATA / "apparel/vrm/Godette_vrm_v4.vrm"
        if not source.is_file():
            pytest.skip(f"there is no {source}; BUNRAKU_DATA names the data")
        path.write_bytes(source.read_bytes())
    page.drop(path)
    page.opened("dropped")
    page.set(0.5)
    record = page.value("studio.character.value")
    assert 0.5 < record["height"] < 3
    if kind == "stl":
        assert record["unit"]["unit"] == "mm" and record["axes"]["up"] == "+z"
        page.page.click("text=/take as metres/")  # a chip repairs a guess
        page.until("studio.character.value.state === 'ready' && studio.character.value.height > 100")
        page.page.click("[aria-label=undo]")
        page.until("studio.character.value.state === 'ready' && studio.character.value.height < 3")
    if kind in ("pmx", "vrm"):
        page.page.click("#body > summary")
        assert record["physics"] and page.page.locator("#apparel").count() == 1
    page.page.click("[aria-label='delete dropped']")
    page.until("studio.character.value?.name !== 'dropped'")


@pytest.mark.parametrize("kind", ["bvh", "amass"])
def test_a_motion_is_dropped(page, tmp_path, kind):
    if kind == "bvh":
        path = tmp_path / "walk.bvh"
        take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
        take_of(page.studio, owner, take).save(path)
    else:
        path = tmp_path / "stands.npz"
        poses = np.zeros((60, 156))
        poses[:, 0] = np.pi / 2  # AMASS has +Z up
        np.savez(path, trans=np.tile([0.0, 0, 0.95], (60, 1)), poses=poses, betas=np.zeros(16),
                 gender=np.array("female"), mocap_framerate=np.array(60.0))  # fmt: skip
    before = page.value("studio.take.value.id")
    page.drop(path)
    page.until(f"studio.take.value.id !== '{before}' && studio.take.value.state === 'done'")
    assert page.value("studio.take.value.how") == "transfer"
    page.shown()
    length = page.value("studio.take.value.seconds")
    assert page.page.inner_text(".block").split() == [path.name, f"{length:.1f}", "s"]
    assert page.page.input_value("#sentence") == ""
    page.page.click(".takes li:last-child .name")  # the first of all, that of the sample
    page.until("studio.take.value.how === 'animate'")
    assert page.page.input_value("#sentence") == page.value("studio.take.value.script[0].text")


def test_a_broken_file_is_said_and_what_was_shown_stays(page, tmp_path):
    before = page.value("[studio.character.value.id, studio.take.value.id]")
    (tmp_path / "broken.glb").write_bytes(b"glTF" + bytes(60))
    page.drop(tmp_path / "broken.glb")
    page.until("studio.notice.value?.bad")
    page.until(f"studio.character.value?.id === '{before[0]}'")
    assert page.value("studio.take.value.id") == before[1]
    save_character(sample_character("mushroom"), tmp_path / "whole.glb")
    page.drop(tmp_path / "whole.glb")
    page.until("studio.character.value?.name === 'whole' && studio.take.value?.state === 'done'")
    page.page.click("[aria-label='delete whole']")


def test_a_sample_that_is_open_is_chosen_and_not_asked_for_its_front(page):
    page.page.click("#sample-dancer")
    page.until("studio.character.value?.name === 'dancer' && studio.take.value?.state === 'done'")
    assert page.page.locator(".fronts").count() == 0
    page.page.click("#sample-dragon")
    page.until("studio.character.value?.name === 'dragon'")
    assert sorted(page.page.locator(".cast .list .name > span:not(.blank)").all_inner_texts()).count("dragon") == 1
    page.page.click("[aria-label='delete dancer']")


def test_undo_takes_back_the_words_and_the_path_with_the_take(page):
    before = page.value("[studio.take.value.id, document.getElementById('sentence').value]")
    page.value("studio.change('', { path: [[0, 0], [0, 1]] })")
    page.type("jumps high")
    page.page.keyboard.press("Escape")
    page.page.click("[aria-label=undo]")
    page.until(f"studio.take.value.id === '{before[0]}'")
    assert page.page.input_value("#sentence") == before[1] and page.value("studio.doc.value.path") == []


def test_directing_opens_one_row_and_cuts_nothing_off(page):
    made = page.studio.sample("mushroom")["id"]
    page.value(f"studio.change('', {{ character: '{made}' }})")
    page.until("document.querySelector('.cast .chosen')?.textContent.includes('mushroom')")
    page.page.click("#fold")
    assert page.page.locator(".row.thin").count() == 1
    row, side = (page.page.locator(name).bounding_box() for name in (".cast .chosen", "aside.left"))
    assert side["y"] <= row["y"] and row["y"] + row["height"] <= side["y"] + side["height"]
    page.page.click("#draw")
    page.page.fill("#path", "0,0 0.4,0.9 1.2,1.6 2.4,1.8 3.4,1.4")
    assert page.value("(({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth)(document.getElementById('path'))")
    page.studio.ask("DELETE", f"/api/characters/{made}")


def test_what_cannot_be_opened_is_said(page, tmp_path):
    path = tmp_path / "note.xyz"
    path.write_text("hello")
    page.drop(path)
    page.until("studio.notice.value && studio.notice.value.bad")
    assert ".xyz" in page.page.inner_text("[role=alert]") and ".glb" in page.page.inner_text("[role=alert]")


def take_of(studio, owner, take):
    """The animation of a take, from the studio's own files."""
    path = studio.folder / "characters" / owner
    character = load_character(next((path / "source").iterdir()))
    return load_take(studio.folder / "takes" / take / "motion.npz", character, load_handles(path / "handles.npz"))


PLACES = """(() => {
    const out = [];
    for (const skin of studio.view().panes[0].model.skins) {
        const spot = skin.position.clone();
        for (let vertex = 0; vertex < skin.geometry.attributes.position.count; vertex += 97) {
            skin.getVertexPosition(vertex, spot);
            spot.applyMatrix4(skin.matrixWorld);
            out.push([spot.x, spot.y, spot.z]);
        }
    }
    return out;
})()"""
"""Vertices as the page's own skinning has them."""


def away(page, posed, height):
    """How far the page's vertices are from the nearest of the library's, at human size [m]."""
    positions = np.array(page.value(PLACES))
    off, _ = cKDTree(posed).query(positions)
    assert len(positions) > 50
    return off.max() * 1.7 / height


def test_scrubbing_puts_the_mesh_where_the_library_has_it(page):
    """Vertices as the page's own skinning has them, against `animation.vertices()`."""
    take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    animation = take_of(page.studio, owner, take)
    page.set(0.5)
    off = away(page, animation.vertices([10])[0], animation.character.height)
    print(f"tracks: {1000 * off:.4f} mm")
    assert off < 1e-4


def test_learned_apparel_has_a_dial_and_is_where_the_library_has_it(page):
    page.page.click("#sample-dancer")  # the dragon wears nothing
    page.opened("dancer")
    page.page.click("#body > summary")
    page.page.select_option("#apparel", "learn")
    page.page.click("#dress")
    page.until("studio.take.value.how === 'dress' && studio.take.value.state === 'done'")
    page.shown()
    first, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    take = take_of(page.studio, owner, first)
    assert take.stiffness == 1 and np.abs(take.points.offsets).max() > 1e-3
    page.set(0.5)
    off = away(page, take.points.vertices([15])[0], take.points.character.height)
    print(f"apparel: {1000 * off:.4f} mm")
    assert off < 1e-4
    page.value(
        """(() => {
            const dial = document.getElementById('stiffness');
            dial.value = '1';
            dial.dispatchEvent(new Event('input', { bubbles: true }));
            dial.dispatchEvent(new Event('change', { bubbles: true }));
        })()"""
    )
    page.until(f"studio.take.value.id !== '{first}' && studio.take.value.state === 'done'")
    page.shown()
    assert page.value("studio.take.value.stiffness") == 10
    assert first not in page.value("studio.takes.value.map((one) => one.id)")  # it was dressed anew, not once more


@pytest.mark.parametrize("sample", ["dragon", "person", "dog", "mushroom", "robot"])
def test_the_pages_silhouette_is_the_renderers(page, sample):
    if page.value("studio.character.value.name") != sample:
        page.page.click(f"#sample-{sample}")
        page.opened(sample)
    take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    animation = take_of(page.studio, owner, take)
    vertices = animation.vertices([10])
    low, high = vertices[0].min(axis=0), vertices[0].max(axis=0)
    target = (low + high) / 2
    eye = target + np.array([0.5, 0.25, 1.0]) * np.ptp(vertices[0], axis=0).max() * 2.6
    size = (400, 300)
    flat = page.value(f"studio.silhouette(0.5, {size[0]}, {size[1]}, {eye.tolist()}, {target.tolist()})")
    seen = np.array(flat, bool).reshape(size[1], size[0])
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], back))
    camera = Camera(eye, np.stack([right, np.cross(back, right), back]))
    mask = silhouette(vertices[0], animation.character.faces, camera, size)
    overlap = (seen & mask).sum() / (seen | mask).sum()
    print(f"{sample}: overlap {overlap:.4f}")
    assert mask.sum() > 2000 and overlap >= 0.97


def silhouette(vertices, faces, camera, size):
    """Where the library's rasteriser sees the mesh."""
    width, height = size
    depth, ids = np.zeros((height, width, 4), np.float32), np.full((height, width, 4), -1, np.int32)
    points = np.ascontiguousarray(vertices, np.float32)
    screen = kernels.project(points, camera.axes, camera.position, camera.focal(height), width, height)
    kernels.rasterise(screen, np.ascontiguousarray(faces, np.int32), depth, ids)
    return (ids >= 0).mean(axis=-1) >= 0.5


def test_a_pin_is_dragged_and_a_span_is_made_anew(page):
    page.value("studio.change('', { script: [{ text: 'walks', seconds: 4 }] })")
    page.type("walks forward")
    page.set(1.0)
    page.until("studio.view().directing")
    page.value("studio.view().draw(true)")
    hand = "studio.view().scene.children.find((one) => one.userData.part === 'left_hand' && one.visible)"
    start = page.page.evaluate(AIM, page.value(f"{hand}.position.toArray()"))
    page.page.mouse.move(*start)
    page.page.mouse.down()
    page.page.mouse.move(start[0] + 15, start[1] - 20)
    page.page.mouse.move(start[0] + 30, start[1] - 40)
    page.page.mouse.up()
    page.until(
        "studio.doc.value.pins.length === 1 && studio.take.value.how === 'bend' && studio.take.value.state === 'done'"
    )
    page.shown()
    page.set(1.0)
    page.value("studio.view().draw(true)")
    pin = page.value("studio.doc.value.pins[0]")
    take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    animation = take_of(page.studio, owner, take)
    ends = limb_ends(Anatomy.of(animation.character, animation.handles))
    position = end_positions(animation.motion, animation.handles, ends)[round(pin["time"] * 20)]
    number = [end.part for end in ends].index(pin["part"])
    assert pin["part"] == "left_hand" and np.linalg.norm(position[number] - pin["position"]) < 0.01

    page.set(0.2)  # or the line of the present would be under the pointer
    page.page.click("#fold")
    row = page.page.locator(".span-row").bounding_box()
    middle = row["y"] + row["height"] / 2
    page.page.mouse.move(row["x"] + row["width"] * 0.25, middle)
    page.page.mouse.down()
    page.page.mouse.move(row["x"] + row["width"] * 0.5, middle)
    page.page.mouse.move(row["x"] + row["width"] * 0.75, middle)
    page.page.mouse.up()
    assert page.value("studio.doc.value.span") == [1.0, 3.0]
    page.type("turns around")
    assert page.value("studio.take.value.how") == "edit"
    new = take_of(page.studio, owner, page.value("studio.take.value.id"))
    before = np.r_[0:5, 75:80]
    np.testing.assert_array_equal(new.motion.rotations[before], animation.motion.rotations[before])
    assert np.abs(new.motion.rotations[30:50] - animation.motion.rotations[30:50]).max() > 0.05


def test_a_path_is_drawn(page):
    page.page.keyboard.press("Escape")
    page.page.keyboard.press("p")
    box = page.page.locator(".stage canvas").bounding_box()
    left, low = box["x"] + box["width"] * 0.3, box["y"] + box["height"] * 0.85
    page.page.mouse.move(left, low)
    page.page.mouse.down()
    for step in range(1, 12):
        page.page.mouse.move(left + step * 25, low - step * 6)
    page.page.mouse.up()
    page.until("studio.doc.value.path.length > 3")
    page.type("walks")
    path = np.array(page.value("studio.doc.value.path"))
    take, owner = page.value("[studio.take.value.id, studio.character.value.id]")
    animation = take_of(page.studio, owner, take)
    root = animation.motion.root_translation[:, [0, 2]]
    dense = np.concatenate([np.linspace(a, b, 50) for a, b in zip(path, path[1:], strict=False)])
    away = np.linalg.norm(root[:, None] - dense, axis=-1).min(axis=1)
    assert away.max() * 1.7 / animation.character.height < 0.10


WAVES = '[{"text":"waves","seconds":0.5}]'


@pytest.fixture
def brief(page):
    """A take of half a second, of which a video is quickly drawn; made once."""
    page.value(f"studio.change('', {{ script: {WAVES} }})")
    made = page.value(
        f"""studio.takes.value.find(
            (one) => one.state === 'done' && one.how === 'animate' && JSON.stringify(one.script) === '{WAVES}')?.id"""
    )
    if made:
        page.value(f"studio.change('', {{ take: '{made}' }})")
        page.shown()
    else:
        page.type("waves")
    return page


def export(page, format):
    """Choose a format and write what is chosen."""
    page.page.click("#export")
    page.page.select_option("#format", format)
    page.page.click("#write")


def test_several_takes_become_the_clips_of_one_file(brief, tmp_path):
    page = brief
    page.type("jumps")
    page.page.click("#export")
    page.page.check("dialog .list li:has-text('waves variation') >> nth=0 >> input")
    page.page.fill("#fps", "60")
    with page.page.expect_download() as found:
        page.page.click("#write")
    path = tmp_path / "clips.glb"
    found.value.save_as(path)
    assert found.value.suggested_filename.endswith("-clips.glb")
    length, _ = struct.unpack("<II", path.read_bytes()[12:20])
    tree = json.loads(path.read_bytes()[20 : 20 + length])
    assert [one["name"] for one in tree["animations"]] == ["jumps", "waves"]


@pytest.mark.parametrize("format", ["GLB", "BVH", "bunraku", "GIF"])
def test_downloads(brief, tmp_path, format):
    page = brief
    with page.page.expect_download() as found:
        export(page, format.lower())
    path = tmp_path / found.value.suggested_filename
    found.value.save_as(path)
    data = path.read_bytes()
    assert data.startswith({"GLB": b"glTF", "BVH": b"HIERARCHY", "bunraku": b"PK", "GIF": b"GIF8"}[format])
    if format == "GLB":
        assert len(load_clip_animation(path).motion) == 10  # half a second at the 20 frames a second of generation
    if format == "GIF":
        from PIL import Image

        with Image.open(path) as picture:
            assert picture.n_frames > 5 and picture.size == (480, 360)


def test_a_video_is_made(brief, tmp_path):
    import av

    page = brief
    with page.page.expect_download() as found:
        export(page, "mp4")
    path = tmp_path / "take.mp4"
    found.value.save_as(path)
    with av.open(str(path)) as video:
        frames = sum(1 for _ in video.decode(video=0))
        assert abs(frames - page.value("studio.take.value.seconds") * 30) <= 2
        assert (video.streams.video[0].width, video.streams.video[0].height) == (1280, 720)


def test_a_take_is_cancelled(page):
    page.value("studio.change('', { script: [{ text: 'walks', seconds: 20 }], steps: 50, count: 1 })")
    page.page.keyboard.press("Escape")
    page.page.click("#animate")
    page.page.wait_for_selector("[aria-label=cancel]")
    page.page.click("[aria-label=cancel]")
    page.until("!document.querySelector('[aria-label=cancel]')")
    assert page.value("studio.takes.value.every((one) => one.state === 'done' || one.state === 'cancelled')")


LOOKS = "JSON.stringify([studio.doc.value.character, studio.doc.value.script, studio.takes.value.map((one) => one.id)])"


def saved(page):
    """Wait until the server knows how the page stands."""
    wanted = page.value("studio.doc.value.script")
    page.studio.until(
        lambda: any(one["view"].get("script") == wanted for one in page.studio.get("/api/about")["projects"]),
        "the project",
    )


def test_a_reload_finds_everything(page):
    page.value("studio.change('', { script: [{ text: 'spins', seconds: 1.5 }] })")
    saved(page)
    before = page.value(LOOKS)
    page.page.goto(page.studio.address)
    page.page.reload()
    page.ready()
    assert page.value(LOOKS) == before


def test_a_restart_finds_everything(browser, own_studio):
    first = own_studio()
    with Page(browser, first) as page:
        page.ready()
        page.value("studio.change('', { script: [{ text: 'spins', seconds: 1.5 }] })")
        page.page.click(".takes li:first-child .icon >> nth=0")
        page.until("studio.take.value.star")
        saved(page)
        before = page.value(LOOKS)
        first.stop()
        page.until("!studio.online.value")
        assert "not connected" in page.page.inner_text("header")
        page.wrong.clear()  # the browser says that the line broke
    second = own_studio(folder=first.folder)
    with Page(browser, second) as page:
        page.ready()
        assert page.value(LOOKS) == before and page.value("studio.take.value.star")


def test_a_link_replays_a_take(browser, studio, page):
    page.type("waves")
    first = page.value("[studio.take.value.id, studio.character.value.id]")
    told = {"character": page.value("studio.character.value.name"), "script": [{"text": "waves", "seconds": 1}],
            "seed": 0, "steps": 2, "guidance": GUIDANCE, "loop": False, "inPlace": False, "path": []}  # fmt: skip
    text = base64.urlsafe_b64encode(json.dumps(told).encode()).decode().rstrip("=")
    with Page(browser, studio, path=f"replay={text}") as other:
        other.ready()
        before = len(studio.get(f"/api/characters/{first[1]}/takes")["takes"])
        assert "waves (1 s)" in other.page.inner_text("dialog")  # it asks first
        assert len(studio.get(f"/api/characters/{first[1]}/takes")["takes"]) == before
        other.page.click("#replay")
        other.until("window.studio?.take.value?.state === 'done' && studio.take.value.script[0].text === 'waves'")
        other.until(f"studio.take.value.id !== '{first[0]}' && studio.take.value.state === 'done'")
        second = other.value("[studio.take.value.id, studio.character.value.id]")
    one, two = take_of(studio, first[1], first[0]), take_of(studio, second[1], second[0])
    np.testing.assert_allclose(one.motion.rotations, two.motion.rotations, atol=1e-5)


def test_the_keyboard_is_enough_and_everything_has_a_name(page):
    page.page.focus("[aria-label=keys]")
    page.page.keyboard.press("Tab")
    assert page.value("document.activeElement.id") == "sentence"  # it comes right after the header
    page.page.keyboard.press("Escape")
    page.page.keyboard.press("/")
    assert page.value("document.activeElement.id") == "sentence"
    page.page.keyboard.press("Escape")
    before = page.value("studio.playing.value")
    page.page.keyboard.press("Space")
    assert page.value("studio.playing.value") != before
    page.page.keyboard.press("ArrowRight")
    assert page.value("studio.playing.value") is False
    nameless = page.value(
        """[...document.querySelectorAll('button, input, select, [role=slider]')].filter((one) => {
            const label = one.getAttribute('aria-label') || one.textContent.trim() || one.title
                || (one.labels && [...one.labels].map((each) => each.textContent).join('').trim()) || one.hidden;
            return !label;
        }).map((one) => one.outerHTML)"""
    )
    assert nameless == []


def test_the_camera_is_turned_by_keys(page):
    eye = "studio.view().camera.position.clone().sub(studio.view().controls.target).toArray()"
    page.page.keyboard.press("Escape")
    before, time = np.array(page.value(eye)), page.value("studio.time.value")
    for there, back in (("Shift+ArrowLeft", "Shift+ArrowRight"), ("Shift+ArrowUp", "Shift+ArrowDown"), ("+", "-")):
        page.page.keyboard.press(there)
        turned = np.array(page.value(eye))
        assert np.linalg.norm(turned - before) > 0.05 * np.linalg.norm(before), there
        nearer = np.linalg.norm(before) / np.linalg.norm(turned)
        assert abs(nearer - (1.15 if there == "+" else 1)) < 1e-6
        page.page.keyboard.press(back)
        np.testing.assert_allclose(page.value(eye), before, atol=1e-6)
    assert page.value("studio.time.value") == time  # the arrows alone step


def test_samples_are_in_sight_beside_many_characters(page):
    made = [page.studio.ask("POST", "/api/characters?sample=mushroom", {})[1] for _ in range(4)]
    for one in made:
        page.studio.done(one["job"])
    page.until("document.querySelectorAll('.cast .list > li').length >= 5")
    hidden = page.value("""[...document.querySelectorAll('.samples .card')].filter((one) => {
        const box = one.getBoundingClientRect();
        return document.elementFromPoint(box.x + box.width / 2, box.y + box.height - 4)?.closest('.card') !== one;
    }).map((one) => one.id)""")
    assert page.page.locator(".samples .card").count() == 6 and hidden == []
    for one in made:
        page.studio.ask("DELETE", f"/api/characters/{one['character']['id']}")


@pytest.mark.parametrize("width", [1280, 800, 420])
def test_nothing_is_cut_off_in_a_narrow_window(page, width):
    page.page.set_viewport_size({"width": width, "height": 800})
    page.until(f"innerWidth === {width} && studio.view().canvas.getBoundingClientRect().width <= {width}")
    assert page.value("document.documentElement.scrollWidth") <= width
    assert page.page.locator("#animate").bounding_box()["x"] >= 0
    box = page.page.locator(".stage canvas").bounding_box()
    assert box["width"] > 150 and box["height"] > 150
    if width > 720:  # the panel at the left covers none of the character
        page.value("studio.view().draw(true)")
        spots = page.value(
            "studio.view().panes[0].model.bones.map((one) => one.getWorldPosition(one.position.clone()))"
        )
        seen = [page.page.evaluate(AIM, [spot["x"], spot["y"], spot["z"]])[0] for spot in spots]
        side = page.page.locator("aside.left").bounding_box()
        assert side["x"] + side["width"] < min(seen) and max(seen) < width
