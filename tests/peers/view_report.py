"""Opens a report.html in a real headless Chromium and looks at it: does it draw, switch layers, move the tool, work by keyboard,
stay readable, and fetch nothing?

usage: view_report.py REPORT.html [--pictures DIR]
Prints one JSON object of figures; exits 1 with the findings on stderr when something is not as it has to be.
Needs Debian's chromium and chromium-driver, selenium and pillow.
"""

import argparse
import base64
import io
import json
import pathlib
import shutil
import sys
import tempfile
import time

from PIL import Image, ImageChops
from selenium import webdriver
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

WIDE, NARROW = (1400, 950), (390, 844)
FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars",
]
# Least contrast of text against what is behind it (WCAG 2.2, level AA); the text of the lowest one comes along.
CONTRAST = """
const light = (c) => { const [r, g, b] = c.map((v) => { v /= 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
const parts = (text) => text.match(/[\\d.]+/g).map(Number);
const behind = (e) => { for (; e; e = e.parentElement) { const c = parts(getComputedStyle(e).backgroundColor);
  if (c.length === 3 || c[3] === 1) return c.slice(0, 3); } return [255, 255, 255]; };
let least = [99, ''];
for (const e of document.querySelectorAll('h1, h2, p, dt, dd span, li, th, td, label, legend, kbd, button, select, output, caption, #legend *')) {
  if (![...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()) || !e.checkVisibility()) continue;
  if (getComputedStyle(e).backgroundColor.startsWith('color(')) continue;
  const [a, b] = [light(parts(getComputedStyle(e).color).slice(0, 3)), light(behind(e))];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  if (ratio < least[0]) least = [ratio, e.textContent.trim().slice(0, 60)];
}
return least;
"""


class Reader:
    """The browser with one report in it."""

    def __init__(self, report, profile, pictures):
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium") or "chromium"
        for flag in [*FLAGS, f"--user-data-dir={profile}", f"--window-size={WIDE[0]},{WIDE[1]}"]:
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
        self.driver = webdriver.Chrome(options=options, service=service)
        self.pictures, self.findings, self.figures = pictures, [], {}
        self.wait = WebDriverWait(self.driver, 90)
        # What the browser's own first page loads is not the report's.
        self.driver.get("about:blank")
        self.driver.get_log("performance")
        self.driver.get(report.resolve().as_uri())
        self.wait.until(lambda d: self.js("return document.documentElement.dataset.ready === 'yes'"))

    def js(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def expect(self, true, finding):
        if not true:
            self.findings.append(finding)

    def settle(self):
        """Waits until everything asked for is drawn: two frames of the browser later."""
        self.driver.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))")

    def soon(self, true, tenths=600):
        """Whether something becomes true within some tenths of a second."""
        for _ in range(tenths):
            if true():
                return True
            time.sleep(0.1)
        return False

    def view(self):
        """The pixels of the 3D view."""
        self.settle()
        picture = self.driver.find_element(By.CSS_SELECTOR, "#canvas canvas").screenshot_as_png
        return Image.open(io.BytesIO(picture)).convert("RGB")

    def keep(self, name, whole=True):
        """Keeps a picture of the whole page, or of what is in the window, smaller."""
        if not self.pictures:
            return
        self.settle()
        width, height = self.js("return [innerWidth, document.documentElement.scrollHeight]")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        shot = self.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip} if whole else {})
        picture = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
        if not whole:
            picture.thumbnail((840, 840), Image.Resampling.LANCZOS)
        picture.save(self.pictures / f"{name}.png", optimize=True)

    def size(self, width, height):
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        self.settle()

    def theme(self, name):
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": name}]})
        self.settle()


def changed(a, b):
    """Share of pixels that differ visibly."""
    difference = ImageChops.difference(a, b).convert("L").point(lambda v: 255 if v > 12 else 0)
    return sum(difference.histogram()[255:]) / (a.width * a.height)


def layers(reader):
    """Every layer draws something of its own."""
    seen, legends = {}, set()
    reader.keep("first", whole=False)
    for name in ["patches", "radius", "residual", "plain"]:
        reader.js("arguments[0].click()", reader.driver.find_element(By.CSS_SELECTOR, f"#layers input[value={name}]"))
        seen[name] = reader.view()
        legends.add(reader.driver.find_element(By.ID, "legend").text)
        colours = seen[name].getcolors(1 << 24)
        most = max(count for count, _ in colours) / (seen[name].width * seen[name].height)
        reader.figures[f"colours_{name}"] = len(colours)
        reader.expect(len(colours) > 60 and most < 0.9, f"layer {name} is not drawn: {len(colours)} colours, one on {most:.0%}")
        reader.keep(f"layer_{name}")
    reader.expect(len(legends) == 4, "the legend does not change with the layer")
    names = list(seen)
    for i, a in enumerate(names):
        for b in names[:i]:
            share = changed(seen[a], seen[b])
            reader.expect(share > 0.03, f"layers {a} and {b} differ on {share:.1%} of the pixels only")
    reader.js("arguments[0].click()", reader.driver.find_element(By.CSS_SELECTOR, "#layers input[value=patches]"))
    for part in ["passes", "tool", "way"]:
        before = reader.view()
        box = reader.driver.find_element(By.CSS_SELECTOR, f"#parts input[name={part}]")
        reader.js("arguments[0].click()", box)
        share = changed(before, reader.view())
        reader.figures[f"part_{part}"] = share
        reader.expect(share > 0.001, f"{part} on or off changes {share:.2%} of the pixels only")
        reader.js("arguments[0].click()", box)


def mouse(reader):
    """Dragging turns the view; the wheel scrolls the page until the view has the focus, then zooms."""
    reader.js("window.scrollTo(0, 0); document.activeElement.blur()")
    place = reader.driver.find_element(By.CSS_SELECTOR, "#canvas canvas")
    wheel = ScrollOrigin.from_element(place)
    webdriver.ActionChains(reader.driver).scroll_from_origin(wheel, 0, 60).perform()
    scrolled = lambda: reader.js("return window.scrollY") > 0
    reader.expect(reader.soon(scrolled), "the wheel over the view does not scroll the page")
    before = reader.view()
    webdriver.ActionChains(reader.driver).click_and_hold(place).move_by_offset(120, 30).release().perform()
    turned = reader.view()
    reader.expect(changed(before, turned) > 0.02, "dragging does not turn the view")
    webdriver.ActionChains(reader.driver).scroll_from_origin(wheel, 0, -300).perform()
    zoomed = lambda: changed(turned, reader.view()) > 0.02
    reader.expect(reader.soon(zoomed), "the wheel over the focused view does not zoom")


def readout(reader):
    return reader.driver.find_element(By.ID, "now").text, reader.driver.find_element(By.ID, "readout").text


def slider(reader):
    """The slider moves tool and axes; so do the charts."""
    slide = reader.driver.find_element(By.ID, "time")
    # Within one patch: the tool does not turn there, so that what changes is its place.
    ends = reader.js("return JSON.parse(document.getElementById('scene').textContent).patches[0].ends")
    put = lambda share: reader.js("arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))", slide, ends * share)
    put(0.4)
    before, said = reader.view(), readout(reader)
    put(0.6)
    after, now = reader.view(), readout(reader)
    reader.figures["tool_moved"] = changed(before, after)
    reader.expect(changed(before, after) > 0.005, "the slider does not move the tool")
    reader.expect(said[0] != now[0] and said[1] != now[1], "the slider does not change the axes' values")
    area = reader.driver.find_element(By.CSS_SELECTOR, "#charts .area")
    reader.js("arguments[0].scrollIntoView({block: 'center'})", area)
    webdriver.ActionChains(reader.driver).move_to_element_with_offset(area, -100, 0).click().perform()
    reader.expect(readout(reader)[0] != now[0], "a click on a chart does not move the tool")
    ink = reader.js("const c = document.querySelectorAll('#charts canvas')[arguments[0]], d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
                    "let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 128; return n", 0)
    reader.expect(ink > 300, f"the charts are empty: {ink} pixels")


def keyboard(reader):
    """Everything is reached and done by keys alone."""
    reader.js("window.scrollTo(0, 0); document.activeElement.blur()")
    place = reader.driver.find_element(By.ID, "canvas")
    keys = lambda *k: webdriver.ActionChains(reader.driver).send_keys(*k).perform()
    seen = set()
    for _ in range(40):
        keys(Keys.TAB)
        focus = reader.driver.switch_to.active_element
        seen.add(focus.get_attribute("id") or focus.get_attribute("name") or focus.get_attribute("aria-labelledby") or "")
    for wanted in ["canvas", "layer", "passes", "play", "speed", "time", "limits", "h-patches"]:
        reader.expect(wanted in seen, f"TAB never reaches {wanted}: {sorted(seen)}")
    reader.js("arguments[0].focus()", place)
    for name, pressed in [("turn", [Keys.ARROW_LEFT] * 4), ("tilt", [Keys.ARROW_UP] * 4), ("zoom", ["+"] * 3), ("layer", ["2"])]:
        before = reader.view()
        keys(*pressed)
        share = changed(before, reader.view())
        reader.expect(share > 0.02, f"key to {name} changes {share:.1%} of the pixels only")
    reader.expect(reader.js("return document.querySelector('#layers input:checked').value") == "radius", "key 2 does not choose the second layer")
    keys(Keys.HOME, "1")
    reader.js("arguments[0].focus()", reader.driver.find_element(By.ID, "time"))
    before = readout(reader)[0]
    keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    reader.expect(readout(reader)[0] != before, "arrow keys do not move the slider")
    # So slow that the program is not at its end meanwhile, however long a frame takes: from there the space bar starts it anew.
    reader.js("document.getElementById('speed').options[0].value = 0.2; document.getElementById('speed').selectedIndex = 0")
    keys(Keys.HOME)
    keys(Keys.SPACE)
    reader.wait.until(lambda d: float(readout(reader)[0].split()[0]) > 0)
    keys(Keys.SPACE)
    still = readout(reader)[0]
    reader.settle()
    reader.expect(readout(reader)[0] == still, "the space bar does not stop the tool")
    reader.expect(not reader.soon(lambda: readout(reader)[0] != still, 5), "the tool moves on after the space bar has stopped it")


def looks(reader):
    """Readable in both themes, wide and narrow."""
    for theme in ["light", "dark"]:
        reader.theme(theme)
        for name, (width, height) in [("wide", WIDE), ("narrow", NARROW)]:
            reader.size(width, height)
            ratio, text = reader.js(CONTRAST)
            reader.figures[f"contrast_{theme}_{name}"] = round(ratio, 2)
            reader.expect(ratio >= 4.5, f"{theme}, {name}: contrast {ratio:.2f} at `{text}`")
            beyond = reader.js("return document.documentElement.scrollWidth - innerWidth")
            reader.expect(beyond <= 0, f"{theme}, {name}: the page is {beyond} px wider than the window")
            reader.keep(f"{theme}_{name}")
    reader.size(*WIDE)


def quiet(reader):
    """Nothing fetched, nothing on the console, nothing foreign in the document."""
    console = [entry["message"] for entry in reader.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
    # Chromium's own remark on software rendering.
    console = [text for text in console if "GPU stall due to ReadPixels" not in text]
    reader.expect(not console, f"console: {console}")
    events = [json.loads(entry["message"])["message"] for entry in reader.driver.get_log("performance")]
    fetched = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    foreign = [url[:120] for url in fetched if not url.startswith(("file:", "data:", "blob:"))]
    reader.figures["fetched"] = len([url for url in fetched if url.startswith("file:")])
    reader.expect(not foreign and reader.figures["fetched"] == 1, f"fetched: {fetched}")
    strange = reader.js("return document.querySelectorAll('img, iframe, object, embed, script[src], link[rel=stylesheet]').length")
    reader.expect(strange == 0, f"{strange} elements that load something")
    handlers = reader.js("return [...document.querySelectorAll('*')].filter((e) => e.getAttributeNames().some((n) => n.startsWith('on'))).length")
    reader.expect(handlers == 0, f"{handlers} elements with handlers")
    reader.figures["title"] = reader.driver.title
    reader.figures["heading"] = reader.driver.find_element(By.TAG_NAME, "h1").text
    reader.figures["triangles"] = reader.driver.find_element(By.ID, "triangles").text


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=pathlib.Path)
    parser.add_argument("--pictures", type=pathlib.Path)
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        reader = Reader(options.report, profile, options.pictures)
        try:
            for check in [layers, mouse, slider, keyboard, looks, quiet]:
                check(reader)
        finally:
            reader.driver.quit()
    print(json.dumps(reader.figures))
    if reader.findings:
        sys.exit("\n".join(reader.findings))


if __name__ == "__main__":
    main()
