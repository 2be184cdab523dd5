"""Look at the built documentation in Chromium: what is wider than its window, what the console reports, and pictures.

    python scripts/look_at_site.py site pictures
    python scripts/look_at_site.py site pictures tools/index.html gallery/index.html

Every page is opened at each width. Pictures are taken of the pages that are named, else of one of each kind, in light
and in dark. Needs Chromium; the site is served on this machine only.
"""

from __future__ import annotations

import json
import queue
import re
import subprocess
import sys
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

WIDTHS = (390, 820, 1400)
HEIGHT = 1800
KINDS = ("index.html", "tutorials/", "concepts/", "gallery/", "tools/", "plugins/", "reference/", "changelog/")
"""Beginnings of addresses, of each of which the first page is taken."""
SECONDS_FOR_ALL = 600
CHROMIUM = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
CONSOLE = re.compile(r"CONSOLE[:(]\d+\)?\]? (?P<said>.*)")
VISITOR = """<!doctype html><meta charset="utf-8"><body><script type="module">
const [pages, widths] = PAGES_AND_WIDTHS
const found = []
for (const width of widths) {
  const frame = document.createElement("iframe")
  frame.width = width
  frame.height = 900
  document.body.append(frame)
  for (const page of pages) {
    await new Promise(loaded => { frame.onload = loaded; frame.src = "/" + page })
    const root = frame.contentDocument.documentElement
    if (root.scrollWidth > root.clientWidth) {
      const wide = [...root.querySelectorAll("body *")].find(one => {
        const box = one.getBoundingClientRect()
        return box.width && box.right >= root.scrollWidth - 1
      })
      found.push([page, width, root.scrollWidth, wide ? wide.outerHTML.slice(0, 120) : ""])
    }
    for (const image of root.querySelectorAll("img"))
      if (image.complete && !image.naturalWidth) found.push([page, width, 0, "no picture: " + image.src])
  }
  frame.remove()
}
await fetch("/visited", {method: "POST", body: JSON.stringify(found)})
</script>
"""


class Server(SimpleHTTPRequestHandler):
    """Serves the site, and the page that visits all others and reports."""

    def __init__(self, *args: Any, visitor: str, reports: queue.Queue[list[Any]], **options: Any) -> None:
        self._visitor, self._reports = visitor.encode(), reports
        super().__init__(*args, **options)

    def do_GET(self) -> None:
        """Answer with a file, or with the visitor."""
        if self.path != "/visit":
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self._visitor)

    def do_POST(self) -> None:
        """Take the visitor's report."""
        self._reports.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        """Say nothing of what is asked."""


def visit(site: Path, pages: list[str]) -> list[str]:
    """Open every page at every width, and return a line for each thing that is wrong."""
    reports: queue.Queue[list[Any]] = queue.Queue()
    visitor = VISITOR.replace("PAGES_AND_WIDTHS", json.dumps([pages, WIDTHS]))
    handler = partial(Server, directory=str(site), visitor=visitor, reports=reports)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, tempfile.TemporaryFile("w+") as log:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/visit"
        command = [*CHROMIUM, "--enable-logging=stderr", "--v=0", "--remote-debugging-port=0", address]
        with tempfile.TemporaryDirectory() as profile:
            browser = subprocess.Popen([*command, f"--user-data-dir={profile}"], stderr=log)
            try:
                found = reports.get(timeout=SECONDS_FOR_ALL)
            finally:
                browser.terminate()
                browser.wait()
                server.shutdown()
        log.seek(0)
        said = sorted({match["said"] for line in log if (match := CONSOLE.search(line))})
    lines = [f"{page} at {width}: {wide} wide: {element}" for page, width, wide, element in found]
    return [*lines, *(f"console: {line}" for line in said)]


def picture(page: str, width: int, *, dark: bool, target: Path) -> None:
    """Write a picture of a page that is opened as a file."""
    scheme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    with tempfile.TemporaryDirectory() as profile:
        command = [*CHROMIUM, scheme, f"--screenshot={target}", f"--window-size={width},{HEIGHT}", page]
        subprocess.run([*command, f"--user-data-dir={profile}"], capture_output=True, timeout=60, check=True)


def main(arguments: list[str]) -> int:
    """Look at the site in the first folder, and write pictures into the second."""
    site, pictures = Path(arguments[0]).resolve(), Path(arguments[1])
    pages = [path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html")) if path.name != "404.html"]
    problems = visit(site, pages)
    for problem in problems:
        print(problem)
    print(f"{len(pages)} pages at {', '.join(map(str, WIDTHS))} pixels, {len(problems)} problems")
    pictures.mkdir(parents=True, exist_ok=True)
    named = arguments[2:] or [next(page for page in pages if page.startswith(kind)) for kind in KINDS]
    for page in named:
        for width in WIDTHS:
            for dark in (False, True):
                name = f"{page.removesuffix('.html').replace('/', '-')}-{width}{'-dark' if dark else ''}.png"
                picture((site / page).as_uri(), width, dark=dark, target=(pictures / name).resolve())
                print(pictures / name)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
