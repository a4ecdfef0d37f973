"""A studio's page in a real browser, as a person meets it: mouse, keys, address, and what went wrong."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.flysid.studio.server import Server


def until(found: Callable[[], Any], seconds: float = 60.0) -> Any:
    """What `found` returns when it returns something true."""
    end = time.monotonic() + seconds
    while True:
        answer = found()
        if answer:
            return answer
        assert time.monotonic() < end, "the page does not get there"
        time.sleep(0.05)


class Page:
    """A browser at a studio; remembers nothing of an earlier one."""

    def __init__(self, browser: Any, server: Server) -> None:
        self.browser = browser
        self.server = server
        browser.get_log("performance")
        browser.get_log("browser")
        browser.get("about:blank")
        browser.get(server.address)
        self.ready(server.address.partition("#/")[2] or "flights")

    def go(self, address: str) -> None:
        self.browser.get("about:blank")
        self.browser.get(f"http://127.0.0.1:{self.server.port}/{address}")
        self.ready(address.lstrip("#/").partition("?")[0])

    def ready(self, page: str) -> None:
        until(lambda: self.js("return document.getElementById('main')?.dataset.ready") == page, 60)

    def js(self, script: str, *given: Any) -> Any:
        return self.browser.execute_script(script, *given)

    def find(self, selector: str) -> Any:
        return self.browser.find_element("css selector", selector)

    def all(self, selector: str) -> list[Any]:
        found: list[Any] = self.browser.find_elements("css selector", selector)
        return found

    def drawn(self) -> str:
        return str(until(lambda: self.js("return document.querySelector('[data-drawn]')?.dataset.drawn")))

    def settled(self) -> str:
        """The window that is drawn, once it is the one in the address and both stay."""
        script = """return [new URLSearchParams(location.hash.split("?")[1]).get("t"),
            document.querySelector("[data-drawn]")?.dataset.drawn]"""

        def same() -> str:
            address, drawn = self.js(script)
            if not address or not drawn:
                return ""
            ends = zip(address.split("~"), drawn.split("~"), strict=True)
            return str(drawn) if all(abs(float(a) - float(b)) < 1e-5 for a, b in ends) else ""

        def lasting() -> str:
            drawn = same()
            time.sleep(0.3)
            return drawn if drawn == same() else ""

        return str(until(lasting))

    def keys(self, *keys: str) -> None:
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.browser).send_keys(*keys).perform()

    def drag(self, place: Any, share: float, pixels: int, *, shift: bool = False) -> None:
        """Drag across an element, from a share of its width on."""
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        self.js("arguments[0].scrollIntoView({block: 'center'})", place)
        hand = ActionChains(self.browser)
        hand = hand.key_down(Keys.SHIFT) if shift else hand
        hand = hand.move_to_element_with_offset(place, round((share - 0.5) * place.size["width"]), 0)
        hand = hand.click_and_hold().move_by_offset(pixels, 0).release()
        (hand.key_up(Keys.SHIFT) if shift else hand).perform()

    def carry(self, source: str, target: str) -> None:
        """Drag one element onto another as a browser tells it: selenium's mouse does not begin such drags."""
        self.js(
            "const data = new DataTransfer(), [a, b] = arguments;"
            "const [from, to] = [a, b].map(x => document.querySelector(x)), "
            "tell = (where, kind) => where.dispatchEvent("
            "new DragEvent(kind, {bubbles: true, cancelable: true, dataTransfer: data}));"
            "tell(from, 'dragstart'); tell(to, 'dragover'); tell(to, 'drop'); tell(from, 'dragend');",
            source,
            target,
        )

    def tab_to(self, selector: str, most: int = 400) -> None:
        """Press Tab until an element has the focus."""
        from selenium.webdriver.common.keys import Keys

        for _ in range(most):
            if self.js("return document.activeElement.matches(arguments[0])", selector):
                return
            self.keys(Keys.TAB)
        raise AssertionError(f"Tab does not get to {selector}")

    def darken(self, on: bool) -> None:
        """The colour scheme that the reader prefers."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if on else "light"}
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})

    def barriers(self) -> list[Any]:
        """What axe-core finds; nothing where FLYSID_AXE does not name its axe.min.js (npm axe-core)."""
        axe = os.environ.get("FLYSID_AXE", "")
        if not axe:
            return []
        self.js(Path(axe).read_text("utf-8"))
        found = self.browser.execute_async_script(
            "const done = arguments[arguments.length - 1]; axe.run(document).then(r => done(r.violations))"
        )
        return [(v["id"], [n["html"][:160] for n in v["nodes"]]) for v in found]

    def barriers_at_any_size(self) -> list[Any]:
        """The same 390, 768 and 1280 pixels wide, light and dark."""
        found: list[Any] = []
        for width in (390, 768, 1280):
            self.browser.set_window_size(width, 900)
            for is_dark in (False, True):
                self.darken(is_dark)
                found += self.barriers()
        self.darken(False)
        return found

    def wrong(self) -> list[str]:
        """Requests that left the server, errors and policy violations in the console."""
        requests = []
        for entry in self.browser.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                requests.append(message["params"]["request"]["url"])
        own = (f"http://127.0.0.1:{self.server.port}/", "about:", "chrome://", "data:")
        left = [url for url in requests if not url.startswith(own)]
        return left + [e["message"] for e in self.browser.get_log("browser") if e["level"] == "SEVERE"]
