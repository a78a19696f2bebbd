"""The page in a browser without a screen: sliders, verdict, map, solver, shapes, and by keys."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="no chromium here: apt-get install chromium")
# Software draws in three dimensions where there is no graphics card.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SOON = 120_000  # ms, in which a busy machine loads models and solves


@pytest.fixture(scope="module")
def address():
    command = [
        sys.executable,
        "-m",
        "foldlab.cli.app",
        "explore",
        "--no-browser",
        "--seconds",
        "250",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    ) as server:  # fmt: skip
        yield server.stdout.readline().strip()
        server.terminate()


@pytest.fixture(scope="module")
def browser():
    sync = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install it")
    with sync.sync_playwright() as play:
        opened = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def page(browser, address):
    opened = browser.new_page(viewport={"width": 1280, "height": 900})
    wrong, elsewhere = [], []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    # What the server refuses is told by the browser, too.
    opened.on(
        "console",
        lambda line: (
            wrong.append(line.text)
            if line.type == "error" and "400 (Bad" not in line.text
            else None
        ),
    )
    opened.on("request", lambda request: elsewhere.append(request.url))
    opened.goto(address)
    opened.wait_for_selector("#verdict[data-by=models]", timeout=SOON)
    yield opened
    assert not wrong
    home = address.partition("#")[0]
    assert all(url.startswith((home, "data:", f"blob:{home}")) for url in elsewhere)
    opened.close()


def answered(page, act):
    """Does something that changes the design, and waits for what the page then says."""
    before = page.get_attribute("#verdict", "data-answers")
    act()
    said = "([n]) => Number(document.getElementById('verdict').dataset.answers) > n"
    page.wait_for_function(said, arg=[int(before)])


def verdict(page):
    return page.inner_text("#verdict strong")


def test_a_slider_moves_the_verdict_and_it_is_read_out(page):
    assert verdict(page) == "Folds"
    page.wait_for_function(
        "() => document.querySelector('.ranges').textContent.includes('of 200 units fold')"
    )
    assert re.search(
        r"chance of folding \d+\.\d %, angle 39\.\d° ± 2\.\d°; 36° count",
        page.inner_text(".numbers"),
    )
    page.focus("#s-h_s")
    answered(page, lambda: page.keyboard.press("End"))
    page.wait_for_selector("#verdict.stays")
    assert verdict(page) == "Does not fold" and page.inner_text(".sign") == "✗"
    page.wait_for_function(
        "() => document.getElementById('live').textContent.includes('Does not fold')"
    )
    assert page.get_attribute("#live", "aria-live") == "polite"
    assert page.get_attribute("#s-h_s", "aria-valuetext") == "2 mm"


def test_numbers_are_typed_with_units_and_what_is_wrong_is_one_sentence(page):
    text = page.locator("[data-name=l_i] input[type=text]")
    answered(page, lambda: (text.fill("0.8 cm"), text.press("Enter")))
    page.focus("#s-l_s")
    assert text.input_value() == "8 mm"
    answered(page, lambda: (text.fill("12"), text.press("Enter")))
    page.focus("#s-l_s")
    assert text.input_value() == "12 mm"
    # What was typed while an answer was on its way stays.
    other = page.locator("[data-name=h_i] input[type=text]")
    for field, value in ((text, "1.3 cm"), (other, "300 um"), (text, "1.1 cm")):
        field.fill(value)
        field.press("Enter")
    page.wait_for_function(
        "() => ['l_i', 'h_i'].map((name) => document.querySelector("
        "`[data-name=${name}] input[type=text]`).value).join() === '11 mm,0.3 mm'"
    )
    answered(page, lambda: (text.fill("70 mm"), text.press("Enter")))
    page.wait_for_selector("#trouble:not([hidden])")
    assert "the hinge lies within its sheet" in page.inner_text("#trouble")
    answered(page, lambda: (text.fill("10 mm"), text.press("Enter")))
    page.wait_for_selector("#trouble", state="hidden")


def test_the_map_is_dragged_and_moved_by_keys(page):
    box = page.locator("#map").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.7 * box["height"], steps=4)
    page.mouse.up()
    page.wait_for_selector("#verdict.stays")
    before = float(page.input_value("#s-h_i"))
    page.focus("#map")
    for key in ("ArrowUp", "Shift+ArrowUp"):
        answered(page, lambda key=key: page.keyboard.press(key))
    assert float(page.input_value("#s-h_i")) == pytest.approx(before + 24, abs=2)
    page.select_option("#map-x", "l_s")
    page.wait_for_function(
        "() => document.querySelector('#map svg').textContent.includes('l_s, mm')"
    )


def test_groups_are_the_same_design_and_back(page):
    answered(page, lambda: page.check("[name=mode][value=groups]"))
    assert page.input_value("[data-name=h_ratio] input[type=text]") == "2"
    assert verdict(page) == "Folds"
    page.wait_for_function(
        "() => document.querySelector('#map svg').textContent.includes('E_i/E_s')"
    )
    answered(page, lambda: page.check("[name=mode][value=sizes]"))
    assert page.input_value("[data-name=l_s] input[type=text]") == "40 mm"
    assert verdict(page) == "Folds"


def test_what_was_just_typed_is_what_is_solved(page):
    asked = []
    page.on("request", lambda sent: asked.append(sent) if "/api/start" in sent.url else None)
    text = page.locator("[data-name=h_s] input[type=text]")
    text.fill("-1")
    text.press("Enter")
    page.click("#solve")
    page.wait_for_selector("#job.wrong")
    assert "expected a finite number above 0" in page.inner_text("#job") and not asked
    text.fill("90 um")
    text.press("Enter")
    with page.expect_request("**/api/start"):
        page.click("#solve")
    assert asked[0].post_data_json["asked"]["design"]["quantities"]["h_s"] == "90 um"
    page.wait_for_selector("#cancel:not([disabled])", timeout=SOON)
    page.click("#cancel")
    page.wait_for_selector("#job.wrong")


def test_a_solve_can_be_cancelled_and_shows_its_shapes(page):
    page.click("#solve")
    page.click("#cancel")
    page.wait_for_selector("#job.wrong")
    assert page.inner_text("#job") == "cancelled"
    page.select_option("#accuracy", "0.05")
    page.focus("#solve")
    page.keyboard.press("Enter")
    page.wait_for_selector("#shape[data-frame] canvas", timeout=SOON)
    told = page.inner_text("#solved")
    assert (
        "folds by 39" in told and "°" in told and "core-seconds" in told and "panels touch" in told
    )
    last = int(page.get_attribute("#shape", "data-frame"))
    assert page.inner_text("#frame-says").startswith("20 %: angle 39")
    page.focus("#frame")
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector(f"#shape[data-frame='{last - 1}']")
    eye = "document.getElementById('shape').layout.scene.camera.eye"
    before = page.evaluate(eye)
    page.focus("#shape")
    page.keyboard.press("ArrowRight")
    page.wait_for_function(f"([y]) => {eye}.y > y + 0.05", arg=[before["y"]])
    assert page.evaluate(eye)["z"] == pytest.approx(before["z"])
    assert len(page.evaluate("document.getElementById('shape').data")) == 3
    assert page.evaluate("document.getElementById('shape').data[0].intensity.length") > 100


def test_a_design_is_pinned_made_to_fold_and_compared(page):
    page.click("#pin")
    page.focus("#s-h_s")
    answered(page, lambda: page.keyboard.press("PageUp"))
    page.wait_for_selector("#verdict.stays")
    table = page.inner_text("#compare table")
    assert "folds, chance 9" in table and "does not fold" in table and "0.1 mm" in table
    assert "40 mm" not in table
    page.check("#same")
    assert "40 mm" in page.inner_text("#compare table")
    page.select_option("#accuracy", "0.05")
    page.click("#mend")
    page.wait_for_selector("#mended li button", timeout=SOON)
    told = page.inner_text("#mended li >> nth=0")
    assert told.startswith("h_s from ") and "confirmed by the solver" in told
    answered(page, lambda: page.click("#mended li button >> nth=0"))
    page.wait_for_selector("#verdict.folds")
    answered(page, lambda: page.click("#back"))
    assert page.input_value("[data-name=h_s] input[type=text]") == "0.1 mm"
    page.click("#unpin")
    page.wait_for_selector("#compare", state="hidden")


def test_the_design_and_its_files_are_exported(page):
    with page.expect_download() as saved:
        page.click("#save")
    design = json.loads(Path(saved.value.path()).read_text(encoding="utf-8"))
    assert design["physical"]["l_s"] == 0.04 and design["models"]["foldable"] is True
    page.select_option("#accuracy", "0.05")
    with page.expect_download(timeout=SOON) as sent:
        page.click("#export")
    assert sent.value.suggested_filename == "foldlab-unit.zip"
    with zipfile.ZipFile(sent.value.path()) as archive:
        assert {"result.json", "shapes.png", "make/cut.dxf"} <= set(archive.namelist())
    assert "in your downloads" in page.inner_text("#job")
    assert page.text_content("#command").startswith('foldlab check --passive "polyester film"')


@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_is_wider_than_the_window_and_every_input_has_a_name(page, width):
    page.set_viewport_size({"width": width, "height": 800})
    page.wait_for_timeout(200)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    nameless = page.evaluate(
        "[...document.querySelectorAll('input, select, button')].filter((e) => "
        "!(e.labels && e.labels.length) && !e.ariaLabel && !e.textContent.trim()).length"
    )
    assert nameless == 0


def test_a_page_without_the_token_is_told_where_to_go(browser, address):
    opened = browser.new_page()
    opened.goto(address.partition("#")[0])
    opened.wait_for_selector("#trouble:not([hidden])")
    assert "foldlab explore" in opened.inner_text("#trouble")
    opened.close()
