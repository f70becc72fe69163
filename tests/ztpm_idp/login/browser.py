"""A browser as far as forms and cookies go, on the application of a test's world."""

from __future__ import annotations

import re
from urllib.parse import urlencode, urlsplit

import httpx2
from tests.ztpm_idp.world import ISSUER

ORIGIN = "http://127.0.0.1:8700"
TOKEN = re.compile(r'name="form_token" value="([0-9a-f]{64})"')


class Browser:
    """Keeps cookies by name, follows nothing by itself, and says what browsers say of each request."""

    def __init__(self, world, *, origin=ORIGIN, http=None):
        self.http = httpx2.Client(transport=world.transport, base_url=ISSUER) if http is None else http
        self.origin = origin
        self.cookies: dict[str, str] = {}
        self.page = None

    def send(self, method, url, content=None, **headers):
        sent = {"cookie": "; ".join(f"{n}={v}" for n, v in self.cookies.items())} if self.cookies else {}
        answer = self.http.request(
            method, url if url.startswith("http") else self.origin + url, content=content, headers=sent | headers
        )
        for line in answer.headers.get_list("set-cookie"):
            first, *attributes = line.split("; ")
            name, _, value = first.partition("=")
            assert {"HttpOnly", "Path=/", "SameSite=lax", "Secure"} <= set(attributes) and name.startswith("__Host-")
            if "Max-Age=0" in attributes:
                self.cookies.pop(name, None)
            else:
                self.cookies[name] = value
        self.page = answer
        return answer

    def get(self, url):
        return self.send("GET", url)

    def post(self, url, fields=None, **headers):
        """Sends the form of the page that was shown last."""
        found = TOKEN.search(self.page.text if self.page is not None else "")
        form = ({"form_token": found[1]} if found else {}) | (fields or {})
        said = {
            "origin": self.origin,
            "sec-fetch-site": "same-origin",
            "content-type": "application/x-www-form-urlencoded",
        }
        kept = {name: value for name, value in (said | headers).items() if value is not None}
        return self.send("POST", url, urlencode(form).encode(), **kept)

    def follow(self):
        """The page that the last answer leads to."""
        assert self.page.status_code == 303, self.page.text
        return self.get(self.page.headers["location"])

    def log_in(self, person):
        """Logs in by a link of this operator."""
        link = person.login_link()
        self.get(link)
        self.post(link)
        assert self.page.status_code == 303, self.page.text
        return urlsplit(self.page.headers["location"]).path

    def who(self):
        """Id of the person who is logged in here, as the account's page says."""
        answer = self.get("/ztpm/login/account")
        return None if answer.status_code == 303 else re.search(r"Logged in as <code>([a-z]+)</code>", answer.text)[1]
