"""Control a headless Chromium over WebDriver (https://www.w3.org/TR/webdriver2/) without a client library."""

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
         "--hide-scrollbars")
START_S, ANSWER_S = 15.0, 30.0


def installed():
    """Tell whether Chromium and its driver are installed."""
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


class Browser:
    """A browser window as a context manager.

    Parameters
    ----------
    width, height : int
        Size of the window [CSS pixels].
    dark : bool
        Whether the reader prefers dark pages.
    """

    def __init__(self, width, height, dark=False):
        self.width, self.height, self.dark = width, height, dark

    def __enter__(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self._home = tempfile.mkdtemp()
        self._server = f"http://127.0.0.1:{port}"
        self._driver = subprocess.Popen(["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, env={**os.environ, "HOME": self._home})
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _start(self):
        options = {"args": [*FLAGS, f"--user-data-dir={self._home}/profile"]}
        capabilities = {"browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        deadline = time.monotonic() + START_S
        while True:
            try:
                answer = self._ask("POST", "/session", {"capabilities": {"alwaysMatch": capabilities}})
                break
            except (ConnectionError, urllib.error.URLError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        self._session = f"/session/{answer['sessionId']}"
        self.devtools("Emulation.setDeviceMetricsOverride", width=self.width, height=self.height,
                      deviceScaleFactor=1, mobile=self.width < 600)
        features = [{"name": "prefers-color-scheme", "value": "dark" if self.dark else "light"}]
        self.devtools("Emulation.setEmulatedMedia", features=features)

    def __exit__(self, *_):
        try:
            if hasattr(self, "_session"):
                self._ask("DELETE", self._session)
        finally:
            self._driver.terminate()
            self._driver.wait(10)
            shutil.rmtree(self._home, ignore_errors=True)

    def _ask(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._server + path, data, {"Content-Type": "application/json"},
                                         method=method)
        # a proxy from the environment cannot reach this machine
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            with opener.open(request, timeout=ANSWER_S) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(f"{method} {path}: {error.read().decode()[:500]}") from None

    def open(self, url):
        """Load a page and wait until it is complete."""
        self._ask("POST", self._session + "/url", {"url": url})

    def run(self, script, *arguments):
        """Run JavaScript in the page and return its result."""
        return self._ask("POST", self._session + "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, script, *arguments):
        """Run JavaScript until its result is true, for `START_S` at most, and return the last result."""
        deadline = time.monotonic() + START_S
        while not (value := self.run(script, *arguments)) and time.monotonic() < deadline:
            time.sleep(0.05)
        return value

    def devtools(self, command, **arguments):
        """Send a command of the DevTools protocol and return its result."""
        body = {"cmd": command, "params": arguments}
        return self._ask("POST", self._session + "/goog/cdp/execute", body)

    def console(self):
        """Return the console messages since the last call."""
        return self._ask("POST", self._session + "/se/log", {"type": "browser"})
