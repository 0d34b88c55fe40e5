"""A page of the dashboard in a real browser."""

from playwright.sync_api import expect

PAGES = {"live": "/", "recordings": "/recordings", "tissues": "/tissues", "studies": "/studies", "system": "/system"}
SIZES = [(1920, 1080), (1280, 800), (800, 1280), (390, 844)]


class Watched:
    """A page with its own browser profile. It collects warnings, errors and requests."""

    def __init__(self, browser, url, width=1280, height=800, theme="dark"):
        self.context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)
        self.page = self.context.new_page()
        self.complaints, self.requests = [], []
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))
        self.page.goto(url)

    def at(self, name):
        return self.page.get_by_test_id(name)

    def start(self, protocol="trapezoid_025hz", cycles=3, tissue="bladder"):
        expect(self.at("protocol").locator("option")).not_to_have_count(0)  # the protocols are loaded
        self.at("protocol").select_option(protocol)
        self.at("cycles").fill(str(cycles))
        self.at("tissue-select").select_option(tissue)
        self.at("start").click()
        expect(self.at("run-message")).to_contain_text("Started")

    def overflow(self):
        """Return by how many pixels the page is wider than the screen."""
        return self.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
