import json
import os
import subprocess
import sys
import time

import pytest
from playwright.sync_api import sync_playwright

# WebGL in software, so that the pictures are the same on machines with and without a graphics card.
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"]


def srflow(*arguments):
    """Runs the command and returns what `--json` prints."""
    command = [os.environ["SRFLOW_BINARY"], "--json", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="session")
def browser():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=os.environ["SRFLOW_CHROMIUM"], args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def tab(browser):
    """A tab in which a message on the console, or a request to anywhere but this machine, is an error."""
    context = browser.new_context(viewport={"width": 1000, "height": 700}, device_scale_factor=1)
    tab = context.new_page()
    tab.set_default_timeout(120_000)
    wrong = []
    tab.on("console", lambda message: message.type == "error" and wrong.append(message.text))
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("request", lambda request: local(request.url) or wrong.append(request.url))
    yield tab
    context.close()
    assert not wrong


def local(url):
    return url.startswith(("file:", "data:", "blob:", "http://127.0.0.1:"))


def show(tab, url):
    """Opens a page and waits until it is drawn."""
    tab.goto(url if "://" in str(url) else f"file://{url}")
    wait_until(tab, "!!window.page")
    settle(tab)


def wait_until(tab, condition, seconds=30):
    """Asks for a condition of JavaScript from outside: `wait_for_function` calls `eval`, which pages do not allow."""
    end = time.monotonic() + seconds
    while not tab.evaluate(condition):
        assert time.monotonic() < end, f"{condition} is not true after {seconds} s"
        tab.wait_for_timeout(20)


def settle(tab):
    tab.evaluate("(async () => { while (window.page.settled) await window.page.settled; })()")


@pytest.fixture
def server():
    """Starts `srflow view ... --serve` and returns its address."""
    running = []

    def start(*arguments):
        command = [os.environ["SRFLOW_BINARY"], "--json", "view", *map(str, arguments), "--serve"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sys.stderr, text=True)
        running.append(process)
        text = ""
        while True:
            text += process.stdout.readline()
            try:
                return json.loads(text)["url"]
            except json.JSONDecodeError:
                assert process.poll() is None, text

    yield start
    for process in running:
        process.kill()
        process.wait()
