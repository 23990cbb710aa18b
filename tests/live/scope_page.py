"""The scope page in a browser, for tests: what it shows and says, and everything that it complained of or asked for."""

from __future__ import annotations

from browser import waited_for
from daemon.rig import PATIENCE_S

LAPTOP = (1366, 768)

# pixels of a picture that are of a series' colour
INKED = """([title, colour]) => {
  const figure = [...document.querySelectorAll("figure")].find((f) => f.textContent.startsWith(title));
  const canvas = figure.querySelector("canvas"), probe = document.createElement("canvas").getContext("2d");
  probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(`--series-${colour}`).trim();
  probe.fillRect(0, 0, 1, 1);
  const wanted = probe.getImageData(0, 0, 1, 1).data;
  const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let i = 0; i < all.length; i += 4)
    if (all[i + 3] > 200 && [0, 1, 2].every((c) => Math.abs(all[i + c] - wanted[c]) < 40)) count++;
  return count;
}"""


# what the page shows when something has not come about
PAGE_TEXT = """["state", "fault", "said", "connection", "rights", "facts"].map((id) =>
  `${id}: ${document.getElementById(id).textContent}`).join("; ")"""


class Page:
    """A page that is looked at, and everything that it complained of or asked for."""

    def __init__(self, browser, served, size=LAPTOP, key=True, **options):
        width, height = size
        self.context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.tab = self.context.new_page()
        self.tab.set_default_timeout(PATIENCE_S * 1000)
        self.troubles, self.requests = [], []
        self.tab.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.tab.on("console", lambda message: message.type == "error" and self.troubles.append(message.text))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.on("websocket", lambda socket: self.requests.append(socket.url))
        self.address = f"{served.url}#{served.key}" if key else served.url

    def open(self):
        self.tab.goto(self.address)
        self.until("document.body.dataset.state !== '' && fffoScope.store")
        if "#" in self.address:
            self.until("fffoScope.mayCommand")
        return self

    def js(self, expression):
        return self.tab.evaluate(expression)

    def until(self, expression):
        """Wait until it is so."""
        value = waited_for(self.tab, expression, PATIENCE_S)
        assert value, f"never: {expression}; {self.js(PAGE_TEXT)}; {self.troubles}"
        return value

    def settled(self, element):
        """Where an element is, once it stands still and nothing covers it: for the mouse."""
        element.hover(trial=True)
        return element.bounding_box()

    def until_state(self, state):
        self.until(f"document.body.dataset.state === '{state}'")

    @property
    def said(self):
        return self.tab.text_content("#said")

    def see(self, seconds):
        """So many seconds of the axis more than now."""
        now_s = self.js("fffoScope.store.now")
        self.until(f"fffoScope.store.now > {now_s + seconds} || fffoScope.store.now < {now_s}")

    def reach(self, name):
        """With Tab, to the element of this id or value."""
        for _ in range(100):
            self.tab.keyboard.press("Tab")
            if self.js("document.activeElement.id || document.activeElement.value") == name:
                assert self.js("getComputedStyle(document.activeElement).outlineStyle") == "solid"
                return
        raise AssertionError(f"{name} is not reached with Tab")
