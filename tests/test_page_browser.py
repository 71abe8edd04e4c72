"""The site in a real browser: it runs, moves, filters, follows clicks, and holds at both widths and themes."""

import json
import shutil
import time
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from test_equilibria_page import folder  # noqa: F401
from test_page import NASTY, SHIPPED, document, material, site  # noqa: F401  (fixtures)

import orbitfinder as of
from orbitfinder.orbits.certify import certify
from orbitfinder.records.family import load_family
from orbitfinder.records.registry import load_orbit
from orbitfinder.show.diagram import changes
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.site.gather import Gathered, gather
from orbitfinder.site.writing import write_site
from orbitfinder.structures.sections import section

webdriver = pytest.importorskip("selenium.webdriver")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.skipif(
        None in (CHROMIUM, DRIVER), reason="no browser: install chromium and chromedriver (Debian: chromium-driver)"
    ),
]
KINDS = {
    "gallery": "index.html",
    "orbit": "orbits/triple-1.html",
    "family": "families/mode-1.html",
    "atlas": "atlases/triples.html",
}
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def pages(site):  # noqa: F811
    """The pages by kind; a family has the name that its problem gave it."""
    family = next(path.relative_to(site).as_posix() for path in (site / "families").glob("*.html"))
    return {kind: site / path for kind, path in (KINDS | {"family": family}).items()}


RUNNING = "return orbitfinder.player.frames > (orbitfinder.player.playing ? 2 : 0)"


def go(browser, page, width=1400, theme="light", motion="no-preference", ready=RUNNING):
    """Open a page at a width and in a theme, and wait until its clock runs, or what else makes it `ready`."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    features = [{"name": "prefers-color-scheme", "value": theme}, {"name": "prefers-reduced-motion", "value": motion}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    browser.get(page.as_uri())
    wait(browser, ready)


def wait(browser, script, patience=15.0, again=lambda: None):
    """Until a script returns something true; what it returned. `again` is done before each look."""
    end = time.monotonic() + patience
    while again() or not (found := browser.execute_script(script)):
        assert time.monotonic() < end, f"never true: {script}"
        time.sleep(0.03)
    return found


def find(browser, selector):
    return browser.find_element("css selector", selector)


CHECKS = (Path(__file__).parent / "data" / "page_checks.js").read_text(encoding="utf-8")


def ask(browser, question, *arguments):
    """The answer of a function of tests/data/page_checks.js."""
    return browser.execute_script(f"{CHECKS}\nreturn checks.{question}(...arguments)", *arguments)


@pytest.mark.parametrize("kind", KINDS)
def test_page_loads_without_a_word_on_the_console(browser, pages, kind):
    browser.get_log("browser")
    go(browser, pages[kind])
    assert browser.get_log("browser") == []
    assert browser.title and find(browser, "h1").text
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(one => one.name)")
    assert not [name for name in loaded if not name.startswith(("file:", "data:"))]


@pytest.mark.parametrize(
    ("width", "theme"),
    [(360, "light"), (1400, "dark"), *(pytest.param(*other, marks=pytest.mark.slow) for other in (
        (360, "dark"), (390, "light"), (390, "dark"), (1400, "light")))],
)  # fmt: skip
@pytest.mark.parametrize("kind", KINDS)
def test_layout_and_contrast_hold(browser, pages, kind, theme, width):
    go(browser, pages[kind], width, theme)
    assert ask(browser, "overflow") == []
    found = ask(browser, "texts")
    assert len(found) > 10
    assert [text for text in found if text[0] < 4.5] == []
    dark = browser.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 26)"
    assert dark == (theme == "dark")


@pytest.mark.parametrize("kind", KINDS)
def test_everything_has_a_name_and_nothing_jumps(browser, pages, kind):
    go(browser, pages[kind])
    assert ask(browser, "nameless") == []
    headings = browser.execute_script(
        "return Array.from(document.querySelectorAll('h1,h2,h3')).map(h => +h.tagName[1])"
    )
    assert headings.count(1) == 1 and all(b - a <= 1 for a, b in pairwise(headings))
    ids = browser.execute_script("return Array.from(document.querySelectorAll('[id]')).map(node => node.id)")
    assert len(ids) == len(set(ids)) or kind != "gallery"
    shift = """const done = arguments[0]; let sum = 0;
    new PerformanceObserver(list => list.getEntries().forEach(one => { if (!one.hadRecentInput) sum += one.value; }))
      .observe({ type: 'layout-shift', buffered: true });
    setTimeout(() => done(sum), 250);"""
    assert browser.execute_async_script(shift) < 0.1


def test_gallery_moves_pauses_and_draws_only_what_is_seen(browser, pages):
    go(browser, pages["gallery"])
    canvas = ".card[data-slug=triple-1] canvas"
    first = ask(browser, "picture", canvas)
    wait(browser, "return orbitfinder.player.time > 0.2")
    assert ask(browser, "picture", canvas) != first
    find(browser, "#play").click()
    assert find(browser, "#play").text == "Play"
    frames = browser.execute_script("return orbitfinder.player.frames")
    held = ask(browser, "picture", canvas)
    time.sleep(0.15)
    assert ask(browser, "picture", canvas) == held
    assert browser.execute_script("return orbitfinder.player.frames") - frames <= 1
    go(browser, pages["gallery"], 390)
    seen, every = browser.execute_script("return [orbitfinder.player.visible.size, orbitfinder.player.scenes.length]")
    assert 0 < seen < every


def test_speed_scales_time(browser, pages):
    go(browser, pages["gallery"])
    browser.execute_script(
        "const s = document.getElementById('speed'); s.value = '4'; s.dispatchEvent(new Event('change'));"
    )
    assert browser.execute_script("return orbitfinder.player.speed") == 4


def test_reduced_motion_starts_at_rest(browser, pages):
    go(browser, pages["gallery"], motion="reduce")
    time.sleep(0.1)
    assert browser.execute_script("return orbitfinder.player.time") == 0
    assert find(browser, "#play").text == "Play"
    find(browser, "#play").click()
    wait(browser, "return orbitfinder.player.time > 0")


def cards(browser):
    return browser.execute_script(
        "return Array.from(document.querySelectorAll('.card:not([hidden])')).map(card => card.dataset.slug)"
    )


def choose(browser, field, value):
    browser.execute_script(
        "const f = document.getElementById(arguments[0]); f.value = arguments[1];"
        "f.dispatchEvent(new Event('input', { bubbles: true }));",
        field, value,
    )  # fmt: skip


def test_filters_filter_and_sorting_sorts(browser, pages):
    go(browser, pages["gallery"])
    everything = cards(browser)
    choose(browser, "mechanism", "quadruple pendulum")
    assert set(cards(browser)) == {slug for slug in everything if slug.startswith("quadruple")}
    choose(browser, "energy-min", "-78")
    assert all(slug.startswith("quadruple-1") for slug in cards(browser)) and cards(browser)
    assert find(browser, "#count").text == f"{len(cards(browser))} of {len(everything)} orbits"
    choose(browser, "search", "no such thing")
    assert cards(browser) == [] and find(browser, "#nothing").is_displayed()
    find(browser, "#reset").click()
    wait(browser, "return document.querySelectorAll('.card[hidden]').length === 0")
    choose(browser, "sort", "period")
    periods = browser.execute_script(
        "return Array.from(document.querySelectorAll('.card')).map(c => +c.dataset.period)"
    )
    assert periods == sorted(periods)
    find(browser, "#order").click()
    periods = browser.execute_script(
        "return Array.from(document.querySelectorAll('.card')).map(c => +c.dataset.period)"
    )
    assert periods == sorted(periods, reverse=True)
    choose(browser, "stability", "elliptic")
    shown = browser.execute_script(
        "return Array.from(document.querySelectorAll('.card:not([hidden])')).map(c => c.dataset.stability)"
    )
    assert set(shown) == {"elliptic"}


def test_a_title_that_is_a_program_is_text(browser, pages, site):  # noqa: F811
    go(browser, pages["gallery"])
    titles = [one.text for one in browser.find_elements("css selector", ".card h3")]
    shown = " ".join(NASTY.replace("\u2028", " ").split())
    assert shown in [" ".join(title.split()) for title in titles]
    nasty = next(path for path in (site / "orbits").glob("*.html") if "stolen" in path.read_text(encoding="utf-8"))
    go(browser, nasty)
    assert " ".join(find(browser, "h1").text.split()) == shown
    assert browser.execute_script("return window.stolen === undefined && document.querySelector('main b') === null")


def test_orbit_page_has_one_clock(browser, pages):
    go(browser, pages["orbit"])
    find(browser, "#play").click()
    slider = "const s = document.getElementById('time'); s.value = arguments[0]; s.dispatchEvent(new Event('input'));"
    dots = "return Array.from(document.querySelectorAll('.mark')).map(mark => mark.style.transform)"
    browser.execute_script(slider, 250)
    wait(browser, "return Math.abs(parseFloat(document.getElementById('clock').textContent) - 0.41) < 0.006")
    first = browser.execute_script(dots)
    browser.execute_script(slider, 600)
    wait(browser, "return Math.abs(parseFloat(document.getElementById('clock').textContent) - 0.99) < 0.006")
    second = browser.execute_script(dots)
    assert len(first) == 7 and all(a != b for a, b in zip(first, second, strict=True))
    checks = certify(load_orbit(SHIPPED / "triple-1" / "orbit.json")).checks
    assert len(browser.find_elements("css selector", "tbody.checks tr")) == len(checks)
    assert "orbitfinder run triple-1.toml" in find(browser, "#commands").text


def test_click_on_a_history_goes_to_that_instant(browser, pages):
    go(browser, pages["orbit"])
    find(browser, "#play").click()
    place = ask(browser, "instant", 1.0)
    click(browser, *place)
    wait(browser, "return Math.abs(parseFloat(document.getElementById('clock').textContent) - 1.0) < 0.02")


def test_downloads_hold_the_orbit(browser, pages):
    go(browser, pages["orbit"])
    caught = """window.saved = []; const make = URL.createObjectURL; URL.createObjectURL = blob => {
        blob.text().then(text => window.saved.push(text)); return make(blob); };
        HTMLAnchorElement.prototype.click = function () {};"""
    browser.execute_script(caught)
    for button in ("#save-toml", "#save-json", "#save-csv"):
        browser.execute_script("document.querySelector(arguments[0]).click()", button)
    saved = wait(browser, "return window.saved.length === 3 && window.saved")
    assert saved[0].startswith('name = "triple-1"') and '"period":1.655338988314641' in saved[1]
    rows = saved[2].splitlines()
    assert rows[0].startswith("t,theta1,") and len(rows) >= 242 and len(rows[5].split(",")) == 7


def click(browser, x, y, hover=False):
    """A click there, or with `hover` only the pointer."""
    for kind, buttons in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1))[: 1 if hover else 3]:
        about = {"type": kind, "x": x, "y": y, "button": "left" if buttons else "none", "clickCount": buttons}
        browser.execute_cdp_cmd("Input.dispatchMouseEvent", about)


@pytest.mark.parametrize("kind", ["family", "atlas"])
def test_hover_and_click_on_a_point_change_the_orbit(browser, pages, kind):
    go(browser, pages[kind])
    energies = []
    for index in (10 if kind == "family" else 0, -1):  # the first five of the family are less than two pixels apart
        x, y, energy = ask(browser, "place", index)
        picked = f"return orbitfinder.picked().energy === {energy!r}"  # a plot that is not ready yet misses a pointer
        wait(browser, picked, again=partial(click, browser, x, y, hover=index >= 0))
        energies.append(energy)
        find(browser, "#play").click()  # paused, then moving again: the picture of this orbit at t = 0 and later
        find(browser, "#play").click()
    if kind == "family":
        assert energies[0] != energies[1]
    text = find(browser, "#picked").text
    assert f"{energies[-1]:.5g}".replace("-", "\N{MINUS SIGN}")[:6] in text
    moved = ask(browser, "picture", "#stage")
    wait(browser, "return orbitfinder.player.playing || (document.getElementById('play').click(), false)")
    time.sleep(0.2)
    assert ask(browser, "picture", "#stage") != moved


def test_family_by_keyboard_and_events(browser, pages):
    from selenium.webdriver.common.keys import Keys

    go(browser, pages["family"])
    slider = find(browser, "#item")
    before = browser.execute_script("return orbitfinder.picked().energy")
    slider.send_keys(Keys.ARROW_LEFT)
    assert browser.execute_script("return orbitfinder.picked().energy") != before
    slider.send_keys(Keys.HOME)
    assert find(browser, "#item-text").text.startswith("1 of ")
    find(browser, "#next").send_keys(Keys.ENTER)
    assert find(browser, "#item-text").text.startswith("2 of ")
    buttons = browser.find_elements("css selector", ".pick")
    assert buttons
    browser.execute_script("arguments[0].click()", buttons[0])
    assert browser.execute_script("return orbitfinder.picked().event") != ""
    dashes = browser.execute_script(
        "return document.getElementById('plot').data.filter(t => t.mode === 'lines').map(t => t.line.dash)"
    )
    assert "solid" in dashes


def test_skip_link_theme_button_and_tab_order(browser, pages):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    go(browser, pages["gallery"])
    ActionChains(browser).send_keys(Keys.TAB).perform()
    focused = browser.switch_to.active_element
    assert focused.text == "Skip to content"
    assert wait(browser, "return document.activeElement.getBoundingClientRect().top >= 0")
    focused.send_keys(Keys.ENTER)
    assert browser.switch_to.active_element.get_attribute("id") == "main"
    theme = find(browser, "#theme")
    theme.send_keys(Keys.ENTER)
    assert theme.text == "Theme: light"
    theme.send_keys(Keys.SPACE)
    assert theme.text == "Theme: dark"
    assert browser.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 26)"
    theme.send_keys(Keys.ENTER)
    assert theme.text == "Theme: system"
    link = find(browser, ".card h3 a")
    link.send_keys(Keys.ENTER)
    wait(browser, "return location.pathname.includes('/orbits/')")


def test_rods_keep_their_length_between_samples(browser, pages):
    """At any instant, not only at the samples: links are rebuilt from angles."""
    go(browser, pages["family"])
    changes = """const worst = []; for (const item of orbitfinder.data.explorer.items) {
        const motion = new orbitfinder.Motion(item.motion), m = motion.points; let low = 1e9, high = 0;
        for (let k = 0; k < 997; k++) { const now = motion.at(k / 997 * item.period);
          const long = Math.hypot(now[2] - now[1], now[m + 2] - now[m + 1]);
          low = Math.min(low, long); high = Math.max(high, long); }
        worst.push(high / low - 1); } return Math.max(...worst);"""
    assert browser.execute_script(changes) < 2e-6


def test_curves_are_drawn_through_all_their_samples(browser, pages):
    go(browser, pages["orbit"])
    corners = "return [...document.querySelectorAll('.portraits .plot')].map(one => one.data[0].line.simplify)"
    assert browser.execute_script(corners) == [False] * 3
    drawn = browser.execute_script("return document.querySelector('.portraits .js-line').getAttribute('d').length")
    assert drawn > 8000


def test_filters_of_the_atlas_find_what_they_name(browser, pages, site):  # noqa: F811
    """Each choice of each filter shows something, in sum everything; nothing left shows nothing."""
    go(browser, site / "atlases" / "quadruples.html")
    for field in ("stability", "symmetry"):
        options = browser.execute_script(
            f"return [...document.getElementById('{field}').options].map(one => one.value)"
        )
        found = []
        for value in options:
            browser.execute_script(
                f"const f = document.getElementById('{field}'); f.value = arguments[0];"
                "f.dispatchEvent(new Event('change'));", value
            )  # fmt: skip
            found.append(int(find(browser, "#item-text").text.split(" of ")[1].split(",")[0]))
        assert found[0] == sum(found[1:]) == 2 and min(found) > 0
        browser.execute_script(f"document.getElementById('{field}').selectedIndex = 0")


def test_round_off_is_no_axis(browser, tmp_path):
    """Multipliers that are 1 but for their last digits are not spread over a plot, nor what it begins with."""
    alike = {"energy": -30.0, "stability": "elliptic"}
    orbits = [
        document(name) | alike | {"floquet_multipliers": [[0.6, size], [0.6, -size]]}
        for name, size in (("quadruple-1", 0.8), ("quadruple-2", 0.8 + 1e-14))
    ]
    (tmp_path / "stable.json").write_text(json.dumps(orbits))
    made, _ = build_site(gather([tmp_path / "stable.json"]), SiteSettings(verify=False))
    write_site(made.files, tmp_path / "site")
    go(browser, tmp_path / "site" / "atlases" / "stable.html")
    wait(browser, "return document.getElementById('plot').layout")
    assert browser.execute_script("return document.getElementById('up').value") == "action"
    browser.execute_script(
        "const up = document.getElementById('up'); up.value = 'largest'; up.dispatchEvent(new Event('change'))"
    )
    low, high = browser.execute_script("return document.getElementById('plot').layout.yaxis.range")
    assert low < -0.01 and high > 0.01


def test_a_pick_is_held_has_an_address_and_back_returns(browser, pages):
    go(browser, pages["family"])
    first = ask(browser, "place", 12)
    click(browser, *first[:2])
    wait(browser, "return document.getElementById('lock').getAttribute('aria-pressed') === 'true'")
    address = wait(browser, "return location.hash")
    assert address == f"#{browser.execute_script('return orbitfinder.picked().key')}"
    last = ask(browser, "place", -1)
    click(browser, *last[:2], hover=True)
    time.sleep(0.3)
    assert browser.execute_script("return orbitfinder.picked().energy") == first[2]
    click(browser, *last[:2])
    wait(browser, f"return orbitfinder.picked().energy === {last[2]!r}")
    browser.back()
    wait(browser, f"return location.hash === '{address}' && orbitfinder.picked().energy === {first[2]!r}")
    browser.get("about:blank")
    browser.get(pages["family"].as_uri() + address)
    wait(browser, f"return orbitfinder.picked && orbitfinder.picked() && orbitfinder.picked().energy === {first[2]!r}")


def test_sliding_keeps_phase_and_scale(browser, pages):
    go(browser, pages["family"])
    find(browser, "#play").click()
    share = "return [orbitfinder.player.time / orbitfinder.picked().period % 1, orbitfinder.player.scenes[0].scale]"
    browser.execute_script("orbitfinder.player.seek(0.3 * orbitfinder.picked().period)")
    wait(browser, "return !orbitfinder.player.stale")
    before = browser.execute_script(share)
    find(browser, "#next").click()
    wait(browser, "return !orbitfinder.player.stale")
    after = browser.execute_script(share)
    assert before[0] == pytest.approx(0.3) and after == pytest.approx(before)


def test_a_family_is_gone_along_without_jumps_and_told_of(browser, pages):
    """Between two orbits the picture passes through what is between, the ring glides, each stop has its sentence."""
    go(browser, pages["family"])
    find(browser, "#play").click()
    browser.execute_script(
        "const s = orbitfinder.player.scenes[0], paint = s.paint; window.seen = [];"
        "s.paint = function (t) { const m = this.motion, n = m.at(t), p = m.tip[0]; seen.push([n[p], n[p + m.points]]);"
        " paint.call(this, t); }; document.getElementById('item').value = 20;"
        "document.getElementById('item').dispatchEvent(new Event('input'));"
    )
    wait(browser, "return seen.length > 4 && !orbitfinder.player.stale")
    seen = np.array(browser.execute_script("return seen"))
    steps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    whole = np.linalg.norm(seen[-1] - seen[0])
    assert steps.sum() < 1.5 * whole and steps.max() < 0.6 * whole  # not at once
    before = browser.execute_script("return orbitfinder.picked().key")
    assert find(browser, "#says").text == browser.execute_script("return orbitfinder.picked().says")
    find(browser, "#travel").click()
    wait(browser, f"return orbitfinder.picked().key !== '{before}'")
    find(browser, "#travel").click()
    assert find(browser, "#travel").text == "Go along"
    ring = (
        "const r = document.querySelector('#plot .ring').getBoundingClientRect(), p = document.getElementById('plot')"
    )
    wait(browser, f"{ring}.getBoundingClientRect(); return r.left > p.left && r.right < p.right && r.top > p.top")
    told = [row.text for row in browser.find_elements("css selector", "#events .event .meta")]
    assert any("a multiplier is -1: a family of twice the period is born" in one for one in told)


def test_a_plot_zooms_and_shows_the_whole_again(browser, pages):
    go(browser, pages["family"])
    width = "const r = document.getElementById('plot')._fullLayout.xaxis.range; return r[1] - r[0]"
    whole = browser.execute_script(width)
    find(browser, "#near").click()
    assert wait(browser, f"{width} < {0.5 * whole} && r[1] - r[0]") == pytest.approx(whole / 3)
    find(browser, "#next").click()
    assert browser.execute_script(width) == pytest.approx(whole / 3)  # a pick leaves the view alone
    find(browser, "#whole").click()
    assert browser.execute_script(width) == pytest.approx(whole)
    choose_change = (
        "const f = document.getElementById('up'); f.value = arguments[0]; f.dispatchEvent(new Event('change'));"
    )
    for up in ("moduli", "angles", "largest", "energy"):
        browser.execute_script(choose_change, up)
        assert browser.execute_script("return document.getElementById('plot').data.length") > 0
    assert find(browser, "#plot-heading").text == "Energy against energy"


def test_the_first_screen_has_the_button_and_the_sliders(browser, pages):
    for kind, ids in (("orbit", ("play", "time")), ("family", ("play", "time", "item")), ("atlas", ("play", "item"))):
        go(browser, pages[kind], width=1440)
        for one in ids:
            assert find(browser, f"#{one}").rect["y"] + find(browser, f"#{one}").rect["height"] <= 900, (kind, one)


def test_search_folds_accents_and_knows_kinds_and_sources(browser, pages):
    go(browser, pages["gallery"])
    everything = cards(browser)
    for text in ("QUADR\u00daple", "report figure 11", "brake triple"):
        choose(browser, "search", text)
        assert 0 < len(cards(browser)) < len(everything), text
    choose(browser, "search", "mode")
    links = browser.execute_script("return document.querySelectorAll('#links > li:not([hidden])').length")
    assert links == 1 and browser.execute_script("return document.querySelectorAll('.group').length") == 0
    choose(browser, "search", "")
    groups = browser.execute_script("return [...document.querySelectorAll('.group')].map(one => one.textContent)")
    assert groups[0].startswith("Single orbits (") and len(groups) == 3
    choose(browser, "stability", "elliptic")
    browser.get(pages["orbit"].as_uri())
    browser.back()
    wait(browser, "return document.getElementById('count').textContent")
    chosen = find(browser, "#stability").get_attribute("value")
    shown = browser.execute_script(
        "return [...document.querySelectorAll('.card:not([hidden])')].map(c => c.dataset.stability)"
    )
    assert chosen == "" or set(shown) == {chosen}


def test_any_two_components_and_a_neighbour(browser, pages):
    go(browser, pages["orbit"])
    choose_change = (
        "const f = document.getElementById(arguments[0]); f.value = arguments[1]; f.dispatchEvent(new Event('change'));"
    )
    browser.execute_script(choose_change, "any-y", "5")
    assert "rate" in browser.execute_script("return document.getElementById('any')._fullLayout.yaxis.title.text")
    before = browser.execute_script("return orbitfinder.player.scenes[0].beside")
    find(browser, "#beside").click()
    assert before is None and browser.execute_script("return orbitfinder.player.scenes[0].beside.period > 4.9")
    assert find(browser, "#beside-note").is_displayed()


def test_two_orbits_stand_beside_each_other_and_share_an_address(browser, pages):
    """What is kept moves by the same clock, with its numbers beside the picked one's; the address brings both back."""
    go(browser, pages["family"])
    kept = browser.execute_script("return orbitfinder.picked().key")
    find(browser, "#keep").click()
    find(browser, "#next").click()
    picked = browser.execute_script("return orbitfinder.picked().key")
    wait(browser, f"return location.hash === '#{picked}&with={kept}'")
    both = "return [...document.querySelectorAll('#picked > div')].map(one => one.querySelectorAll('dd').length)"
    assert set(browser.execute_script(both)) == {2}
    address = browser.execute_script("return location.href")
    browser.get("about:blank")
    browser.get(address)
    wait(browser, f"return orbitfinder.picked && orbitfinder.picked() && orbitfinder.picked().key === '{picked}'")
    periods = browser.execute_script("return orbitfinder.player.scenes.map(one => one.motion.period)")
    assert len(periods) == 2 and periods[0] != periods[1] and find(browser, "#kept").is_displayed()
    find(browser, "#keep").click()
    wait(browser, f"return location.hash === '#{picked}'")
    assert not find(browser, "#kept").is_displayed()


@pytest.fixture(scope="module")
def potential(tmp_path_factory):
    """A section of the Henon-Heiles system with an orbit in it, as pages."""
    out = tmp_path_factory.mktemp("potential")
    orbit = load_orbit(SHIPPED.parent / "gallery" / "henon-heiles-loop" / "orbit.json")
    of.sections.save_section(section(orbit, seeds=4, returns=12), out / "section.json")
    of.save_orbit(orbit, out / "orbit.json")
    made, _ = build_site(gather([out / "section.json", out / "orbit.json"]), SiteSettings("HH", verify=False))
    write_site(made.files, out / "site")
    return out / "site"


def test_motions_of_a_section_have_addresses_and_zoom(browser, potential):
    page = next((potential / "sections").glob("*.html"))
    data = potential / "data" / "sections" / f"{page.stem}.js"
    data.write_text(data.read_text().replace('"undecided"', '"regular"'))  # as of a longer section
    go(browser, page, 390, "dark")
    colours = "return document.getElementById('plot').data.find(one => one.name === 'regular').marker.color"
    assert len(set(browser.execute_script(colours))) == 3
    assert ask(browser, "overflow") == [] and ask(browser, "nameless") == []
    found = ask(browser, "texts")
    assert len(found) > 10 and [text for text in found if text[0] < 4.5] == []
    go(browser, page)
    find(browser, "#next").click()
    wait(browser, "return location.hash === '#motion=2'")
    width = "const r = document.getElementById('plot')._fullLayout.xaxis.range; return r[1] - r[0]"
    whole = browser.execute_script(width)
    find(browser, "#near").click()
    wait(browser, f"{width} < {0.5 * whole}")
    browser.get("about:blank")
    browser.get(page.as_uri() + "#motion=3")
    wait(browser, "return orbitfinder.picked && orbitfinder.picked().name === 'motion 3'")
    assert find(browser, "#lock").text == "Held"


PICKED = "return orbitfinder.picked && orbitfinder.picked() && document.querySelector('#plot .main-svg')"


@pytest.fixture(scope="module")
def resting(folder, tmp_path_factory):  # noqa: F811
    """The page of equilibria with the cycles from their Hopf point."""
    out = tmp_path_factory.mktemp("resting")
    write_site(build_site(gather([folder]))[0].files, out / "site")
    return out / "site" / "equilibria" / "chemistry.html"


@pytest.mark.parametrize("width", [360, 1400])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_of_equilibria_is_whole(browser, resting, theme, width):
    browser.get_log("browser")
    go(browser, resting, width, theme, ready=PICKED)
    assert browser.get_log("browser") == []
    assert ask(browser, "overflow") == [] and ask(browser, "nameless") == []
    found = ask(browser, "texts")
    assert len(found) > 10 and [text for text in found if text[0] < 4.5] == []


def test_equilibria_are_picked_by_slider_pointer_and_event(browser, resting):
    go(browser, resting, ready=PICKED)
    first = find(browser, "#picked").text
    assert "rate\n1.8" in first and "Stability\nstable" in first
    assert len(find(browser, "#eigenvalues").text.split()) == 4
    browser.execute_script(
        "const bar = document.getElementById('item'); bar.value = bar.max; bar.dispatchEvent(new Event('input'))"
    )
    wait(browser, "return document.getElementById('picked').textContent.includes('unstable')")
    assert "verify equilibria/chemistry/equilibria.json#" in find(browser, "#command").text
    find(browser, ".pick").click()
    wait(browser, "return location.hash === '#event=0'")
    assert "supercritical Hopf point" in find(browser, "#picked").text
    assert find(browser, "#command").text.endswith("continue equilibria/chemistry/equilibria.json --switch 0")
    assert find(browser, "#lock").text == "Held"
    reach = browser.execute_script("return document.getElementById('plane')._fullLayout.xaxis.range")
    assert reach[1] > 1e-3  # at a Hopf point the real parts are round-off, which is no axis


def test_stability_is_seen_and_a_click_on_a_cycle_opens_it(browser, resting):
    go(browser, resting, ready=PICKED)
    data = """return document.getElementById('plot').data.filter(one => one.mode.startsWith('lines'))
      .map(one => [one.name, one.line.dash, one.x[0], one.x[one.x.length - 1]])"""
    cycles, rest = [], []
    for name, *line in browser.execute_script(data):
        (cycles if name.startswith("cycles") else rest).append(line)
    assert [dash for dash, *_ in rest] == ["solid", "dash"]
    assert np.allclose([ends for _, *ends in rest], [[1.8, 2.0], [2.0, 2.4]])
    assert len(cycles) == 2 and all(dash == "solid" and low >= 2 for dash, low, _ in cycles)
    browser.execute_script("""const up = document.getElementById('up');
      up.value = '-2'; up.dispatchEvent(new Event('change'))""")
    wait(
        browser, "return document.getElementById('plot').data.every(one => !one.name || !one.name.startsWith('cycles'))"
    )
    crossed = browser.execute_script(
        "return document.getElementById('plot').data[0].y.filter(y => Math.abs(y) > 1e-9)"
        ".filter((y, k, all) => k && y * all[k - 1] < 0).length"
    )
    assert crossed == 1
    browser.execute_script("""const up = document.getElementById('up');
      up.value = '1'; up.dispatchEvent(new Event('change'));
      const plot = document.getElementById('plot');
      const cycle = plot.data.find(one => (one.name || '').startsWith('cycles'));
      plot.emit('plotly_click', { points: [{ customdata: cycle.customdata[1] }] })""")
    wait(browser, "return location.href.endsWith('/families/cycles.html#point=1')")
    wait(browser, "return window.orbitfinder && orbitfinder.picked && orbitfinder.picked().key === 'point=1'")
    back = find(browser, "#events-heading ~ .meta a")
    assert back.text == "chemistry, hopf 0"
    back.click()
    wait(browser, "return location.href.endsWith('/equilibria/chemistry.html#event=0')")


def test_lines_of_equal_potential_lie_under_a_motion(browser, potential):
    """One for each level, and the last for the motion's own energy."""
    go(browser, next((potential / "orbits").glob("*.html")))
    wait(browser, "return (orbitfinder.player.scenes[0].lines || []).length === 7")
    assert browser.execute_script("return orbitfinder.player.scenes[0].level") == 0.125


# --------------------------------------------------------------------------------------------------
# The same stage in a notebook: the widget's module mounted on a page that stands for the host.


@pytest.fixture(scope="module")
def spatial(tmp_path_factory):
    """A site with a spherical pendulum that turns, an orbit between Earth and Moon, and a robot's leg."""
    files = [SHIPPED.parent / "gallery" / name / "orbit.json" for name in ("spherical-pendulum", "three-body-lyapunov")]
    files.append(SHIPPED.parents[1] / "docs" / "gallery" / "orbits" / "robots-a1-leg.json")
    site_, _ = build_site(gather(files), SiteSettings(verify=False))
    out = tmp_path_factory.mktemp("spatial") / "site"
    write_site(site_.files, out)
    return out / "orbits"


SEEN = "const s = orbitfinder.player.scenes[0], m = s.motion;"
INK = """const d = s.pen.getImageData(0, 0, s.canvas.width, s.canvas.height).data; let n = 0;
for (let k = 3; k < d.length; k += 4) n += d[k] > 0; return n"""


@pytest.mark.parametrize("width", [390, pytest.param(1400, marks=pytest.mark.slow)])
def test_what_moves_in_space_is_turned_by_hand_and_by_keys(browser, spatial, width):
    """The rod is as long in the picture as turning its three coordinates says; the time goes on where it was."""
    go(browser, spatial / "spherical-pendulum.html", width, motion="reduce")
    stage = find(browser, "#stage")
    assert stage.get_attribute("tabindex") == "0" and "arrow keys" in stage.get_attribute("aria-label")
    seen = f"""{SEEN} const at = m.at(0.3), [a, e] = s.turned, p = s.point(at, 1), o = s.point(at, 0);
        return [a, e, s.scale, [at[1], at[3], at[5]], [p[0] - o[0], p[1] - o[1], p[2] - o[2] * 1]]"""
    first = browser.execute_script(seen)
    mouse = webdriver.ActionChains(browser)
    mouse.move_to_element(stage).click_and_hold().move_by_offset(60, 24).release().perform()
    stage.send_keys("+")
    wait(browser, f"{SEEN} return !orbitfinder.player.stale && s.width > 0")
    second = browser.execute_script(seen)
    assert second[0] - first[0] == pytest.approx(0.5) and second[1] - first[1] == pytest.approx(0.2)
    for azimuth, height, scale, (down, right, eye), (across, lower, _) in (first, second):
        away = np.cos(azimuth) * eye + np.sin(azimuth) * right  # from the vertical, towards the eye
        wanted = scale * np.array([
            np.cos(azimuth) * right - np.sin(azimuth) * eye, np.cos(height) * down + np.sin(height) * away,
        ])  # fmt: skip
        assert [across, lower] == pytest.approx(wanted, abs=0.01)
    stage.send_keys(webdriver.Keys.HOME)
    wait(browser, f"{SEEN} return !orbitfinder.player.stale && s.width > 0")
    assert browser.execute_script(seen) == first and ask(browser, "overflow") == []


def test_a_robot_is_seen_by_its_solids_the_nearer_before_the_farther(browser, spatial):
    """All that is drawn is within the picture; bodies hide each other by their depth; without solids they are lines."""
    browser.get_log("browser")
    go(browser, spatial / "a1-leg.html", motion="reduce")
    page = spatial.parent / "data" / "orbits" / "a1-leg.js"
    assert page.stat().st_size < 80_000 and page.read_text().count("orbitfinder.put") == 2
    assert page.with_name("spherical-pendulum.js").read_text().count("orbitfinder.put") == 1
    seen = f"""{SEEN} const w = s.dots.width, at = [];
        new Uint32Array(s.dots.data.buffer).forEach((dot, k) => {{ if (dot) at.push(k % w); }});
        const [low, high] = [Math.min, Math.max].map(end => at.reduce((a, b) => end(a, b)));
        const rows = [...new Uint32Array(s.dots.data.buffer)].flatMap((dot, k) => dot ? [Math.floor(k / w)] : []);
        return [w, s.dots.height, at.length, low, high, rows[0], rows.at(-1)]"""
    wait(browser, f"{SEEN} return Boolean(s.dots)")
    wide, high, dots, left, right, top, bottom = browser.execute_script(seen)
    assert 0 < left < right < wide - 1 and 0 < top < bottom < high - 1
    assert 0.03 < dots / (wide * high) < 0.5 and browser.get_log("browser") == []
    depths = browser.execute_script(f"""{SEEN} const now = m.at(0);
        return m.strokes.filter(one => one[0] === 'solid').map(one => {{
          const at = s.point(now, one[1][0]), k = Math.round(2 * at[1]) * s.dots.width + Math.round(2 * at[0]);
          return [at[2] * 2 * s.scale, s.depths[k]]; }})""")
    assert len(depths) == 4 and all(near > middle + 2 for middle, near in depths)  # of each its middle is inside
    ink = browser.execute_script(f"{SEEN} {INK}")
    browser.execute_script(
        f"{SEEN} s.dots = null; delete orbitfinder.data[m.around.solids]; orbitfinder.player.stale = true"
    )
    wait(browser, "return !orbitfinder.player.stale")
    assert browser.execute_script(f"{SEEN} return s.dots === null")
    assert browser.execute_script(f"{SEEN} {INK}") < 0.8 * ink
    drawn = browser.execute_script(f"""{SEEN} const now = m.at(0);
        return m.strokes.filter(one => one[0] === 'bone').map(one => {{
          const [a, b] = one[1].map(p => s.point(now, p));
          return s.pen.getImageData((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 1, 1).data[3]; }})""")
    assert drawn == [255] * 3


def test_a_relative_orbit_goes_on_turning_over_the_end_of_its_period(browser, spatial):
    go(browser, spatial / "spherical-pendulum.html", motion="reduce")
    apart = f"""{SEEN} const at = t => Array.from(m.at(t * m.period)).slice(0, 6);
        const gap = (a, b) => Math.max(...at(a).map((x, k) => Math.abs(x - at(b)[k]))); let most = 0;
        for (let k = 0; k < 2000; k++) most = Math.max(most, gap(k / 100, (k + 1) / 100));
        return [most, gap(0, 1), gap(0, 20)]"""
    step, turned, back = browser.execute_script(apart)
    assert step < 0.1 < 0.5 < turned and back < 0.05
    go(browser, spatial / "three-body-lyapunov.html", motion="reduce")
    wait(browser, "return orbitfinder.player.stale === false")  # painted: before, nothing has a place in the picture
    inside = browser.execute_script(f"{SEEN} return m.around.marks.map(one => [one[0], !s.within(s.spot(one[1]))[2]])")
    assert dict(inside)["L1"] and not dict(inside)["Earth"]
    before = browser.execute_script(f"{SEEN} {INK}")
    browser.execute_script(f"{SEEN} m.around.marks = []; s.width = 0; orbitfinder.player.stale = true")
    wait(browser, "return !orbitfinder.player.stale")
    assert browser.execute_script(f"{SEEN} {INK}") < before - 50  # a cross, an arrow and its name were there


def test_the_curve_of_a_family_changes_its_line_at_the_event(browser, tmp_path_factory):
    """Unstable stretches are dashed to the event and not beyond; what nothing decides is dotted; the legend says so."""
    family = load_family(SHIPPED.parent / "families" / "five-bar-length" / "family.json")
    unsure = replace(family, points=(replace(family.points[0], stability="marginal"), *family.points[1:]))
    out = tmp_path_factory.mktemp("stretches")
    write_site(build_site(Gathered(families=[unsure]), SiteSettings(verify=False))[0].files, out / "site")
    go(browser, next((out / "site" / "families").glob("*.html")), motion="reduce")
    lines = browser.execute_script(
        "const p = document.getElementById('plot'); document.getElementById('across').value = 'value';"
        "document.getElementById('across').dispatchEvent(new Event('change'));"
        "return p.data.filter(t => t.mode === 'lines').map(t => [t.name, t.line.dash, t.x, t.showlegend])"
    )
    assert lines[0][:2] == ["undecided", "dot"] and {tuple(line[:2]) for line in lines} == {
        ("undecided", "dot"), ("stable", "solid"), ("unstable", "dash"),
    }  # fmt: skip
    assert sum(line[3] for line in lines) == 3
    told = changes(unsure)
    assert len(lines) == len(told) + 1
    for (_, at), before, after in zip(told, lines, lines[1:], strict=False):
        assert before[2][-1] == after[2][0] != None  # noqa: E711
        if at is not None:
            assert before[2][-1] == pytest.approx(unsure.events[at].parameter)


HOST = """<!doctype html><meta charset="utf-8"><title>a notebook</title><style>{css}</style>
<body style="font: 14px sans-serif"><main id="host"></main><script type="module">{esm}
const state = {state}, heard = {{}};
window.model = {{ get: key => state[key], save_changes() {{}},
  set(key, value) {{ state[key] = value; (heard["change:" + key] || []).forEach(one => one()); }},
  on(key, one) {{ (heard[key] = heard[key] || []).push(one); }},
  off(key, one) {{ heard[key] = heard[key].filter(other => other !== one); }} }};
window.host = document.getElementById("host");
window.gone = render({{ model, el: host }});
</script>"""


@pytest.fixture(scope="module")
def notebook(tmp_path_factory):
    """A page with the widget of a family, and the family."""
    whole = load_family(SHIPPED.parent / "families" / "five-bar-length" / "family.json")
    family = replace(whole, points=whole.points[:: -(-len(whole.points) // 5)], events=whole.events[3:4])
    stage = family.widget()
    state = {name: getattr(stage, name) for name in ("shown", "index", "playing", "speed")}
    page = tmp_path_factory.mktemp("notebook") / "host.html"
    text = json.dumps(state).replace("<", "\\u003c")
    page.write_text(HOST.format(css=stage._css, esm=stage._esm, state=text), encoding="utf-8")
    return page, family


def mounted(browser, page, width=900):
    browser.get_log("browser")
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-reduced-motion", "value": ""}]}
    )
    browser.get(page.as_uri())
    wait(browser, "return window.host && host.orbitfinder && host.orbitfinder.player.frames > 2")
    return lambda script: browser.execute_script(f"const {{ player, scene }} = host.orbitfinder; {script}")


SLIDE = """const s = host.querySelector(`input[aria-label="${arguments[0]}"]`);
s.value = arguments[1]; s.dispatchEvent(new Event("input"));"""


@pytest.mark.needs("notebook")
def test_the_widget_slides_keeps_phase_and_scale_and_tells_the_kernel(browser, notebook):
    page, family = notebook
    run = mounted(browser, page)
    loaded = run("return performance.getEntriesByType('resource').map(one => one.name)")
    assert browser.get_log("browser") == [] and loaded == []
    find(browser, "#host button").click()
    assert run("return [player.playing, model.get('playing')]") == [False, False]
    browser.execute_script(SLIDE, "time", 300)
    wait(browser, "return !host.orbitfinder.player.stale")
    seen = """const one = selector => host.querySelector(selector);
        return [player.time / scene.motion.period, scene.scale, one('canvas').toDataURL(),
        [...scene.motion.at(player.time)], one('.of-diagram circle:last-child').getAttribute('cx'),
        [...host.querySelectorAll('tr')].map(row => row.textContent),
        host.querySelectorAll('svg')[1].getCurrentTime()]"""
    first = run(seen)
    browser.execute_script(SLIDE, "along the family", 5)
    wait(browser, "return !host.orbitfinder.player.stale")
    last = run(seen)
    assert first[0] == pytest.approx(0.3) and last[0] == pytest.approx(0.3) and first[1] == last[1] > 0
    assert first[2] != last[2] and max(abs(a - b) for a, b in zip(first[3], last[3], strict=True)) > 0.05
    assert float(last[4]) > float(first[4]) and run("return model.get('index')") == 5
    assert last[5][0] == f"period{family.points[-1].period:.12g} s"
    assert last[6] == pytest.approx(0.3 * family.points[-1].period, rel=1e-3)
    wanted = find(browser, "#host .of-diagram").rect
    browser.execute_script("model.set('index', 0); model.set('speed', 0.25); model.set('playing', true)")
    assert run("return [host.orbitfinder.picked(), player.speed, player.playing]") == [0, 0.25, True]
    browser.execute_script(
        "const e = {clientX: arguments[0], clientY: arguments[1], bubbles: true};"
        "host.querySelector('.of-diagram svg').dispatchEvent(new MouseEvent('click', e));",
        wanted["x"] + wanted["width"] - 20, wanted["y"] + 150,
    )  # fmt: skip
    assert run("return model.get('index')") == 5


@pytest.mark.needs("notebook")
@pytest.mark.parametrize("width", [360, 900])
def test_the_widget_takes_the_colours_of_its_host_and_leaves_nothing_behind(browser, notebook, width):
    run = mounted(browser, notebook[0], width)
    link = "return [host.firstChild.dataset.theme, getComputedStyle(scene.canvas).getPropertyValue('--link').trim()]"
    assert run(link) == ["light", "#0072b2"] and ask(browser, "overflow") == []
    assert [text for text in ask(browser, "texts") if text[0] < 4.5] == []
    assert run("return getComputedStyle(document.documentElement).getPropertyValue('--link')") == ""
    browser.execute_script("document.body.style.background = '#111'; document.body.style.color = '#eee'")
    wait(browser, "return host.firstChild.dataset.theme === 'dark'")
    assert run(link) == ["dark", "#56b4e9"]
    assert [text for text in ask(browser, "texts") if text[0] < 4.5] == []
    blue = """const c = scene.canvas, d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let k = 0; k < d.length; k += 4) n += d[k] === 0x56 && d[k + 1] === 0xb4 && d[k + 2] === 0xe9; return n"""
    wait(browser, f"const {{ scene }} = host.orbitfinder; {blue} > 50")
    assert ask(browser, "nameless") == []
    frames = run("gone(); return player.frames")
    time.sleep(0.2)
    assert run("return player.frames") == frames
