#!/usr/bin/env python3
"""Opens a workspace's report.html in headless Chromium, as a person would, and looks at it.

usage: report_page.py S2GS WORKSPACE [--chromium PATH] [--screenshots FOLDER]

Makes the report, opens it from disk, wide and narrow, light and dark. Fails on any console message, any request
besides the file itself, anything wider than its page, a viewer that draws nothing or does not turn, a slider that
does not move, or buttons that do not sort. --screenshots keeps a picture of each layout.
"""
import argparse
import base64
import contextlib
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

FLAGS = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync", "--mute-audio",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-pipe"]
PATIENCE_S = 240  # for one answer, on a loaded machine


class Browser:
    """Chromium, driven by the DevTools protocol over a pipe: messages are JSON, each ended by a zero byte."""

    def __init__(self, path, profile):
        to_browser, self.sink = os.pipe()
        self.source, from_browser = os.pipe()

        def plug():  # the browser reads descriptor 3 and writes descriptor 4
            saved = os.dup(to_browser), os.dup(from_browser)
            os.dup2(saved[0], 3)
            os.dup2(saved[1], 4)

        self.process = subprocess.Popen([path, *FLAGS, f"--user-data-dir={profile}", "about:blank"], preexec_fn=plug,
                                        close_fds=False, start_new_session=True, stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL)
        os.close(to_browser)
        os.close(from_browser)
        self.buffer = b""
        self.number = 0
        self.session = None
        self.events = []
        page = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)["sessionId"]

    def receive(self):
        while b"\0" not in self.buffer:
            part = os.read(self.source, 1 << 20)
            if not part:
                sys.exit("chromium ended early")
            self.buffer += part
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, **params):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.sink, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            answer = self.receive()
            if answer.get("id") == self.number:
                if "error" in answer:
                    sys.exit(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)
        sys.exit(f"{method}: no answer")

    def wait_for(self, event):
        while not any(e.get("method") == event for e in self.events):
            self.events.append(self.receive())

    def js(self, expression):
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            sys.exit(f"{expression}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def close(self):
        """Ends the browser and its helper processes, which outlive it and still write into the profile."""
        self.process.terminate()
        self.process.wait()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)


FRAME = "new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))"
# How many different colours the viewer shows, and a digest of them.
CANVAS = """(() => {
  const canvas = document.querySelector('.viewer canvas');
  if (!canvas) return null;
  const gl = canvas.getContext('webgl');
  const pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const words = new Uint32Array(pixels.buffer);
  return {drawn: words.reduce((n, w) => n + (w !== 0), 0) / words.length, colors: new Set(words).size,
          digest: words.reduce((h, w) => (Math.imul(h, 31) + w) | 0, 7)};
})()"""
# Elements that stick out of the page, unless what they are in scrolls.
WIDE = """[...document.querySelectorAll('body *')].filter((e) => {
  if (e.closest('.scroll') || e.closest('svg')) return false;
  const box = e.getBoundingClientRect();
  return box.width > 0 && (box.right > innerWidth + 1 || box.left < -1);
}).map((e) => e.tagName + '.' + e.className + ' ' + (e.textContent || '').slice(0, 40))"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("s2gs")
    parser.add_argument("workspace")
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    parser.add_argument("--screenshots")
    args = parser.parse_args()
    if not args.chromium:
        sys.exit("no chromium: .ci/install_packages test")
    subprocess.run([args.s2gs, "report", "--workspace_path", args.workspace], check=True)
    page = pathlib.Path(args.workspace, "report.html").resolve()
    numbers = json.loads(page.with_suffix(".json").read_text())
    faults = []

    def expect(holds, fault):
        if not holds:
            faults.append(fault)

    # A helper process that is just dying may still write a file between the listing of a folder and its removal.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(args.chromium, profile)
        for domain in ("Page", "Runtime", "Log", "Network"):
            browser.call(domain + ".enable")
        browser.call("Network.setCacheDisabled", cacheDisabled=True)
        for width, scheme in ((1400, "light"), (400, "dark"), (400, "light"), (1400, "dark")):
            layout = f"{width} px, {scheme}"
            browser.events.clear()
            browser.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1,
                         mobile=False)
            browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            browser.call("Page.navigate", url=page.as_uri())
            browser.wait_for("Page.loadEventFired")
            browser.js(FRAME)

            wide = browser.js(WIDE)
            expect(not wide, f"{layout}: wider than the page: {wide[:5]}")
            expect(browser.js("document.documentElement.scrollWidth <= innerWidth"), f"{layout}: scrolls sideways")
            dark = browser.js("getComputedStyle(document.body).backgroundColor.match(/\\d+/g)[0] < 128")
            expect(dark == (scheme == "dark"), f"{layout}: the wrong colours")
            broken = browser.js("[...document.images].filter((i) => !i.complete || !i.naturalWidth).length")
            expect(broken == 0, f"{layout}: {broken} broken pictures")

            if numbers["report"]["mesh"]:
                seen = browser.js(CANVAS)
                expect(seen and seen["drawn"] > 0.02 and seen["colors"] > 50, f"{layout}: the viewer shows {seen}")
                box = browser.js("(() => { const c = document.querySelector('.viewer canvas'); c.scrollIntoView({block: 'center', behavior: 'instant'});"
                                 " const b = c.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()")
                browser.js(FRAME)
                x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
                for kind, dx in (("mousePressed", 0), ("mouseMoved", 60), ("mouseReleased", 60)):
                    browser.call("Input.dispatchMouseEvent", type=kind, x=x + dx, y=y, button="left", buttons=1,
                                 clickCount=1)
                    browser.js(FRAME)  # moves are held back until a frame is drawn
                expect(browser.js(CANVAS)["digest"] != seen["digest"], f"{layout}: the viewer does not turn")
                for mode in ("views", "shape"):
                    before = browser.js(CANVAS)["digest"]
                    browser.js(f"document.querySelector('[data-mode={mode}]').click()")
                    browser.js(FRAME)
                    expect(browser.js(CANVAS)["digest"] != before, f"{layout}: the viewer has no mode {mode}")
            if numbers["report"]["pictures"].get("compared"):
                cut = browser.js("""(() => { const s = document.querySelector('.stage input'); s.value = 25;
                    s.dispatchEvent(new Event('input'));
                    return getComputedStyle(document.querySelector('.stage .over:not([hidden])')).clipPath; })()""")
                expect("25%" in cut, f"{layout}: the slider leaves the cut at {cut}")
                shown = browser.js("""(() => { document.querySelector('.stage').previousElementSibling
                    .querySelector('[data-panel="3"]').click();
                    return [...document.querySelectorAll('.stage img')].filter((i) => !i.hidden)
                        .map((i) => i.dataset.panel).join(); })()""")
                expect(shown == "0,3", f"{layout}: the mask's button shows panels {shown}")
            if numbers["report"]["photos"]:
                residuals = browser.js("""(() => { document.querySelector('[data-key=residual]').click();
                    return [...document.querySelectorAll('.photo')].map((p) => p.dataset.residual)
                        .filter((r) => r !== '').map(Number); })()""")
                expect(residuals == sorted(residuals, reverse=True), f"{layout}: photos are not sorted")
                named = browser.js("[...document.querySelectorAll('.photo b')].map((b) => b.textContent)")
                expect(sorted(named) == sorted(p["name"] for p in numbers["report"]["photos"]),
                       f"{layout}: the photos are not those of report.json")

            for event in browser.events:
                method, params = event.get("method"), event.get("params", {})
                if method == "Network.requestWillBeSent":
                    url = params["request"]["url"]
                    expect(url == page.as_uri() or url.startswith("data:"), f"{layout}: asks for {url[:120]}")
                if method == "Log.entryAdded":
                    # The browser's own remarks on drawing without a GPU are not the page's.
                    text = params["entry"]["text"]
                    own = params["entry"]["source"] == "rendering" or "swiftshader" in text.lower() or "GPU" in text
                    expect(own, f"{layout}: {text}")
                if method in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown"):
                    expect("GL Driver Message" in json.dumps(params), f"{layout}: {json.dumps(params)[:300]}")
            if args.screenshots:
                browser.js("document.querySelector('[data-mode=color]')?.click(); scrollTo(0, 0)")
                browser.js(FRAME)
                height = browser.js("document.documentElement.scrollHeight")
                for top in range(0, height, 3000):
                    clip = {"x": 0, "y": top, "width": width, "height": min(3000, height - top), "scale": 1}
                    shot = browser.call("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
                    path = pathlib.Path(args.screenshots, f"{width}_{scheme}_{top // 3000}.png")
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(base64.b64decode(shot["data"]))
        browser.close()
    if faults:
        sys.exit("\n".join(faults))
    print(f"{page}: {page.stat().st_size / 1e6:.2f} MB, four layouts, no fault")


main()
