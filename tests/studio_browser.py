"""The studio's server and a browser that works on its page, for the tests and for benchmarks/studio.py."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
BROWSER = bool(CHROMIUM and DRIVER)
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
)  # fmt: skip


class Server:
    """`orbitfinder studio` in a folder of its own."""

    def __init__(self, folder, *arguments):
        command = [sys.executable, "-m", "orbitfinder", "studio", "--no-browser", *arguments]
        environment = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
        environment["PYTHONPATH"] = str(ROOT)  # and NiceGUI must not think that it is tested
        self.log = (folder / "log.txt").open("w+")
        self.process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=self.log, text=True, env=environment
        )
        self.address = self.process.stdout.readline().strip().partition(": ")[2]

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        self.process.wait(20)
        self.process.stdout.close()

    def words(self):
        """What it wrote to standard error."""
        self.log.seek(0)
        return self.log.read()


class Tab:
    """A browser with the studio open, or still empty."""

    def __init__(self, address, folder):
        from selenium import webdriver

        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for flag in (*FLAGS, f"--user-data-dir={folder}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
        self.size(1440)
        if address:
            self.open(address)

    def size(self, width, dark=False):
        size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        theme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": theme})

    def open(self, address):
        self.driver.get(address)
        self.until("return window.stage && stage.shown > 0 && document.getElementById('readout').innerText")

    def ask(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def until(self, script, patience=90.0):
        end = time.monotonic() + patience
        while not (found := self.ask(script)):
            assert time.monotonic() < end, f"never true: {script}; {self.text('status')}"
            time.sleep(0.02)
        return found

    def text(self, name):
        return self.ask("const e = document.getElementById(arguments[0]); return e ? e.innerText : ''", name)

    def click(self, name):
        self.ask("document.getElementById(arguments[0]).click()", name)

    def open_panel(self, name):
        self.ask("document.querySelector(`#${arguments[0]} .q-item`).click()", name)
        self.until(f"return document.querySelector('#{name} button') !== null")

    def said(self, pattern, patience=90.0):
        self.until(f"return /{pattern}/.test(document.getElementById('status').innerText)", patience)

    def turn(self, joint, angle):
        """Take the joint at the end of a link and let it go, at rest, where the link has an angle (rad)."""
        before, place = (np.array(self.ask("stage.rewind(); return stage.joint(arguments[0])", k))
                         for k in (joint - 1, joint))  # fmt: skip
        there = before + np.hypot(*(place - before)) * np.array([np.sin(angle), np.cos(angle)])
        self.drag(joint, *(2 * round(x / 2) for x in there - place))

    def drag(self, joint, across, down, flick=False):
        """Take a joint where the motion begins and let it go elsewhere, at rest or moving."""
        from selenium.webdriver.common.action_chains import ActionChains

        place = self.ask("stage.rewind(); return stage.joint(arguments[0])", joint)
        canvas, before = self.driver.find_element("id", "stage"), self.ask("return stage.shown")
        size = canvas.rect
        moves = ActionChains(self.driver, duration=20)
        moves.move_to_element_with_offset(
            canvas, round(place[0] - size["width"] / 2), round(place[1] - size["height"] / 2)
        )
        moves.click_and_hold().move_by_offset(across // 2, down // 2).move_by_offset(across // 2, down // 2)
        (moves if flick else moves.pause(0.25)).release().perform()
        self.until(f"return stage.shown > {before}")

    def pulled_between(self, joint, across, down):
        """Pull a joint with a hand that moves between an answer and its picture: how far (px) from there is where it is
        told to be when it is let go of."""
        from selenium.webdriver.common.action_chains import ActionChains

        place = self.ask("stage.rewind(); return stage.joint(arguments[0])", joint)
        scale, *start = self.ask(f"""const emit = window.emitEvent, show = stage.show, s = orbitfinder.player.scenes[0];
            let last = null;
            addEventListener('pointermove', event => {{ last = event; }}, true);
            window.emitEvent = (name, what) => {{
              window.there = what.velocity && what.place;
              return emit(name, what); }};
            stage.show = (...film) => {{
              show(...film);
              s.canvas.dispatchEvent(new PointerEvent('pointermove', last)); }};
            const m = s.motion, now = m.at(0);
            return [s.scale, now[{joint}], now[{joint} + m.points]]""")
        canvas, before = self.driver.find_element("id", "stage"), self.ask("return stage.shown")
        size, moves = canvas.rect, ActionChains(self.driver, duration=20)
        away = (round(x - size[side] / 2) for x, side in zip(place, ("width", "height"), strict=True))
        moves.move_to_element_with_offset(canvas, *away)
        moves.click_and_hold().move_by_offset(across, down).perform()
        self.until(f"return stage.shown > {before}")
        ActionChains(self.driver, duration=20).release().perform()
        there = self.until("return window.there")
        return scale * np.abs(np.array(there) - start - np.array([down, across]) / scale).max()

    def escape(self):
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        ActionChains(self.driver).send_keys(Keys.ESCAPE).perform()
        self.until("return !document.querySelector('.certificate')")

    def slide(self, name, share):
        """Click on the slider of a parameter at a share of its way."""
        from selenium.webdriver.common.action_chains import ActionChains

        slider = self.driver.find_element("css selector", f'#parameters [aria-label="{name}"]')
        self.ask("arguments[0].scrollIntoView({block: 'center'})", slider)
        before = None
        while before != (before := slider.rect):  # the panel is still opening
            time.sleep(0.2)
        across = round((share - 0.5) * slider.rect["width"])
        ActionChains(self.driver).move_to_element_with_offset(slider, across, 0).click().perform()

    def slid(self):
        """Milliseconds from a key on the slider to the next orbit on the stage."""
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        self.ask("document.querySelector('#slide [tabindex]').focus()")
        watch = """const n = stage.shown; window.took = 0;
        document.addEventListener('keydown', () => { const t = performance.now();
          const look = () => stage.shown > n ? window.took = performance.now() - t : requestAnimationFrame(look);
          requestAnimationFrame(look); }, { once: true, capture: true });"""
        times = []
        for key in [Keys.ARROW_RIGHT] * 6 + [Keys.ARROW_LEFT] * 12:
            self.ask(watch)
            ActionChains(self.driver, duration=1).send_keys(key).perform()
            times.append(self.until("return window.took", 10.0))
        return times


def shared():
    """How much longer things take than on a quiet machine, for which the limits are."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def children(process):
    """The processes that one has started, and those have."""
    threads = Path(f"/proc/{process}/task").glob("*/children")
    own = [int(one) for file in threads for one in file.read_text().split()]
    return [*own, *(deeper for one in own for deeper in children(one))]
