"""The live page in Chromium: how often it is drawn, what that costs, how late it is, whether its memory is flat."""

import gzip
import shutil

from playwright.sync_api import Page, sync_playwright
from service import Service

from app.api.app import STATIC_FOLDER
from app.messages.json_schema import describe_frame_layout

SIZE = {"width": 1920, "height": 1080}
SETTLE_S = 5.0

# An update begins with its animation frame and ends when the browser is free again: a message to itself tells, which
# waits until style, layout and painting are done.
PROBE = """
(() => {
  const probe = (window.probe = { updates: [], messages: [], toScreen: [], bytes: 0 });
  const newestAt = NEWEST_AT;
  let newest = NaN;
  const frame = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => frame((now) => {
    const begin = performance.now();
    draw(now);
    const channel = new MessageChannel();
    channel.port1.onmessage = () => {
      probe.updates.push(performance.now() - begin);
      if (Number.isFinite(newest)) probe.toScreen.push(Date.now() - newest);
      newest = NaN;
    };
    channel.port2.postMessage(null);
  });
  const { set, get } = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage");
  Object.defineProperty(WebSocket.prototype, "onmessage", {
    get,
    set(listener) {
      set.call(this, listener && ((event) => {
        const begin = performance.now();
        listener(event);
        probe.messages.push(performance.now() - begin);
        probe.bytes += event.data.byteLength ?? event.data.length;
        if (event.data instanceof ArrayBuffer) newest = new DataView(event.data).getFloat64(newestAt, true);
      }));
    },
  });
})();
"""


def measure(minutes: float) -> list[dict]:
    """Floors after DASHBOARD and the issue: aims on two cores without a GPU."""
    probe = PROBE.replace("NEWEST_AT", str(describe_frame_layout()["offsets"]["newest_ms"]))
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with Service("serve", "--demo") as service, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport=SIZE)
        page.add_init_script(probe)
        page.goto(service.url)
        page.wait_for_timeout(SETTLE_S * 1e3)
        first_s = min(60.0, minutes * 30.0)
        figures = _watch(page, first_s)
        early_mb = _heap_mb(page)
        page.evaluate("for (const list of ['updates', 'messages', 'toScreen']) probe[list] = []")
        page.wait_for_timeout((minutes * 60.0 - first_s) * 1e3)
        late_mb = _heap_mb(page)
        browser.close()
    return [
        *figures,
        _row(f"page: heap after {first_s:.0f} s", early_mb, "MB", ""),
        _row(f"page: heap after {minutes:.3g} min", late_mb, "MB", "flat"),
        _row("page: program of the live page, gzipped", _bundle_kb(), "kB", "under 150"),
    ]


def _watch(page: Page, seconds: float) -> list[dict]:
    page.evaluate(
        "for (const list of ['updates', 'messages', 'toScreen']) probe[list] = []; probe.bytes = 0; "
        "probe.began = performance.now()"
    )
    page.wait_for_timeout(seconds * 1e3)
    seen = page.evaluate("""() => {
        const at = (list, share) => list.toSorted((a, b) => a - b)[Math.floor(list.length * share)];
        const s = (performance.now() - probe.began) / 1e3;
        return {
            rate: probe.toScreen.length / s,
            drawing: at(probe.updates, 0.95), drawing50: at(probe.updates, 0.5),
            message: at(probe.messages, 0.95),
            early: at(probe.toScreen, 0.5), late: at(probe.toScreen, 0.95),
            bytes: probe.bytes / s,
        };
    }""")
    return [
        _row("page: updates a second", seen["rate"], "", "30"),
        _row("page: main thread for an update, p50", seen["drawing50"], "ms", ""),
        _row("page: main thread for an update, p95", seen["drawing"], "ms", "under 10"),
        _row("page: main thread for a message, p95", seen["message"], "ms", ""),
        _row("page: sample to screen, p50", seen["early"], "ms", ""),
        _row("page: sample to screen, p95", seen["late"], "ms", "under 60"),
        _row("page: bytes a second for a viewer", seen["bytes"] / 1e3, "kB/s", ""),
    ]


def _heap_mb(page: Page) -> float:
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    used = session.send("Runtime.getHeapUsage")["usedSize"]
    session.detach()
    return used / 1e6


def _bundle_kb() -> float:
    """What the live page loads: the document, and the files that it names."""
    document = (STATIC_FOLDER / "index.html").read_text(encoding="utf-8")
    loaded = [path for path in (STATIC_FOLDER / "assets").iterdir() if path.name in document]
    worker = (STATIC_FOLDER / "assets").glob("ticker.worker-*")
    return sum(len(gzip.compress(path.read_bytes())) for path in [STATIC_FOLDER / "index.html", *loaded, *worker]) / 1e3


def _row(name: str, value: float, unit: str, floor: str) -> dict:
    return {"name": name, "value": value, "unit": unit, "floor": floor}
