"""A page opened in headless Chromium, and what a script in it reports."""
from __future__ import annotations

from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import json
from pathlib import Path
import queue
import subprocess
import threading
from typing import Any

LONGEST = 120.0         # [s] to wait for the report of a page
FLAGS = ('headless', 'no-sandbox', 'disable-gpu', 'no-first-run', 'disable-background-networking',
         'disable-component-update', 'disable-sync')
# The browser runs in real time: with its virtual time a timeout may end before a frame is drawn.
REPORT = """<script>
const report = found => fetch('/report', {method: 'POST', body: JSON.stringify(found)});
</script>"""


class Browser:
    """A page in a browser, until it is closed; a context manager.

    Attributes:
        pid: that of the browser's first process, and of its session.
    """

    def __init__(self, text: str, script: str, folder: Path, width: int = 1400):
        """Open the page.

        Args:
            text: the page.
            script: elements that begin its head; once `report(value)` is called there, `value`
                can be had from `reported`.
            folder: for the browser's profile.
            width: of its window [px].
        """
        found: queue.Queue[Any] = queue.Queue()
        served = text.replace('<head>', f'<head>{REPORT}{script}').encode()

        class Handler(BaseHTTPRequestHandler):
            """Serves the page, and takes its report."""

            def do_GET(self) -> None:
                """Send the page, and nothing else."""
                self.send_response(200 if self.path == '/' else 404)
                self.send_header('Content-Type', 'text/html; charset=utf-8')
                self.end_headers()
                self.wfile.write(served if self.path == '/' else b'')

            def do_POST(self) -> None:
                """Take the report."""
                found.put(json.loads(self.rfile.read(int(self.headers['Content-Length']))))
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                """Say nothing."""

        self._found = found
        self._server = ThreadingHTTPServer(('127.0.0.1', 0), Handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self._process = subprocess.Popen(
            ['chromium', *(f'--{flag}' for flag in FLAGS), f'--window-size={width},900',
             f'--user-data-dir={folder / "profile"}',
             f'http://127.0.0.1:{self._server.server_port}/'],
            stderr=subprocess.DEVNULL, start_new_session=True)
        self.pid = self._process.pid

    def __enter__(self) -> Browser:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the browser."""
        self._process.terminate()
        self._process.wait()
        self._server.shutdown()
        self._server.server_close()

    def reported(self) -> Any:
        """Wait for the value that the script reports.

        Raises:
            TimeoutError: it reported none.
        """
        try:
            return self._found.get(timeout=LONGEST)
        except queue.Empty:
            raise TimeoutError('the browser did not report on the page') from None
