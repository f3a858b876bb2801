"""A reader in front of the workbench: hands on knobs, eyes on the picture."""

import base64
import re
import time

CELLS = 5  # of the notebook, up to the workbench
CHANGE = "before => document.querySelector('.widget-image').src !== before"
LOADED = "() => document.querySelector('.widget-image').complete"
# Time from letting go of the mouse to the next picture, measured in the page.
STOPWATCH = """() => { window.times = []; let start = 0;
    window.addEventListener('mouseup', () => { start = performance.now(); }, true);
    document.querySelector('.widget-image').addEventListener('load',
        () => window.times.push(performance.now() - start)); }"""
BYTES = """async () => {
    const blob = await (await fetch(document.querySelector('.widget-image').src)).blob();
    const bytes = new Uint8Array(await blob.arrayBuffer());
    return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), '')); }"""

# Whether nothing has moved for ten pictures of the screen.
AT_REST = """async () => {
    const places = () => JSON.stringify([...document.querySelectorAll('.widget-box *')]
        .map(each => each.getBoundingClientRect()));
    const before = places();
    for (let k = 0; k < 10; k++) await new Promise(requestAnimationFrame);
    return places() === before; }"""

CLIPPED = """() => [...document.querySelectorAll(
        '.jp-OutputArea .widget-label, .jp-OutputArea .jupyter-button, .workbench-python')]
    .filter(each => each.offsetParent && each.scrollWidth > each.clientWidth + 1)
    .map(each => each.innerText)"""


class Reader:
    """Opens the notebook, runs it up to the workbench, and turns knobs."""

    def __init__(self, page, address, patience):
        self.page, self.patience, self.complaints = page, patience, []
        page.set_default_timeout(1000 * patience)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(address)
        page.wait_for_selector(".jp-Notebook .jp-CodeCell")
        page.keyboard.press("Control+b")  # the list of files away
        page.get_by_text("| Idle").wait_for()  # the kernel; before, cells are not run
        page.locator(".jp-Notebook .jp-MarkdownCell").first.click()
        for _ in range(CELLS):
            page.keyboard.press("Shift+Enter")
        page.wait_for_selector(".widget-image")
        page.wait_for_function(LOADED)
        page.evaluate(STOPWATCH)

    def knob(self, name):
        """The box of a widget, found by its label."""
        label = self.page.locator(".widget-label", has_text=re.compile(f"^{re.escape(name)}$"))
        knob = self.page.locator(".widget-inline-hbox", has=label)
        row = self.page.locator(".widget-hbox", has=knob)  # with the field beside a slider
        return row if row.count() else knob

    def drag(self, name, share, release=True):
        """Take a slider's handle to a share of its track."""
        handle = self.knob(name).locator(".noUi-handle")
        handle.scroll_into_view_if_needed()
        box, track = (handle.bounding_box(), self.knob(name).locator(".noUi-base").bounding_box())
        mouse = self.page.mouse
        mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        mouse.down()
        mouse.move(track["x"] + share * track["width"], box["y"] + box["height"] / 2, steps=8)
        if release:
            mouse.up()

    def type(self, name, text):
        """Type into a field, or into the number beside a slider, and confirm."""
        field = self.knob(name).locator("input").last
        field.click()
        self.page.keyboard.press("Control+a")
        self.page.keyboard.type(text)
        self.page.keyboard.press("Enter")

    def choose(self, name, option):
        """Choose from a list, and wait for what comes of it."""
        self.after(self.knob(name).locator("select").select_option, option)

    def read(self, name):
        """What stands beside a slider."""
        return self.knob(name).locator("input").last.input_value()

    def after(self, action, *arguments):
        """Do something, and wait for the next picture; its bytes."""
        before = self.page.locator(".widget-image").get_attribute("src")
        action(*arguments)
        self.page.wait_for_function(CHANGE, arg=before)
        self.page.wait_for_function(LOADED)
        return self.picture

    @property
    def picture(self):
        """The bytes of the PNG file that is shown."""
        return base64.b64decode(self.page.evaluate(BYTES))

    def until(self, text):
        """Wait until the lines contain a text."""
        self.page.wait_for_function(
            "text => document.querySelector('.workbench-python').innerText.includes(text)", arg=text
        )

    def until_drawn(self, picture):
        """Wait until a picture is shown, by its bytes: a page's function cannot wait for them."""
        until = time.monotonic() + self.patience
        while self.picture != picture:
            assert time.monotonic() < until, "another picture is shown"
            self.page.wait_for_timeout(50)

    def show(self, width, height, path):
        """Make the window as large, and take a picture of it."""
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.locator(
            ".widget-image:visible, .workbench-certificate"
        ).first.scroll_into_view_if_needed()
        self.page.wait_for_function(AT_REST)
        self.page.screenshot(path=path)

    @property
    def overflow(self):
        """Labels, buttons and fields of the workbench that are clipped, by what they say."""
        return self.page.evaluate(CLIPPED)

    @property
    def certificate(self):
        """The text below the picture."""
        return self.page.locator(".workbench-certificate").inner_text()

    @property
    def times(self):
        """Milliseconds from letting go of the mouse to each picture so far."""
        return self.page.evaluate("() => window.times")

    @property
    def python(self):
        """The lines that are shown."""
        return self.page.locator(".workbench-python").inner_text()
