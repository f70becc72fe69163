"""A browser on the console as far as forms go, at a provider with a name."""

from __future__ import annotations

import html
import json
import re
from urllib.parse import parse_qsl, urlencode, urlsplit

from tests.ztpm_idp.login.browser import Browser
from ztpm_idp.console import acts, revoking

from capabilities.statements.people.assertion import relying_party

NAMED = "http://localhost:8700/ztpm"
AT = "/ztpm/console"
_HIDDEN = re.compile(r'<input type="hidden" name="(\w+)" value="([^"]*)">')
_CODE = re.compile(r"Code <code>([A-Z_]+)</code>")


class Looking(Browser):
    """A person who looks at the console."""

    def __init__(self, world, name=None):
        super().__init__(world, origin=NAMED.removesuffix("/ztpm"))
        self.world, self.name = world, name
        if name is not None:
            self.log_in(world.people[name])

    def see(self, path, **headers):
        """The text of a page of the console, which is there."""
        answer = self.send("GET", AT + path, **headers)
        assert answer.status_code == 200, answer.text
        return answer.text

    def code(self):
        """Code of the refusal that was shown last."""
        found = _CODE.search(self.page.text)
        return None if found is None else found[1]

    def asked_anew(self):
        """Page to which a login leads from the refusal that was shown last."""
        found = re.search(r'<a href="(/ztpm/login[?][^"]*)">Log in', self.page.text)
        return None if found is None else dict(parse_qsl(urlsplit(html.unescape(found[1])).query))["back_to"]

    def question(self, kind, id_):
        """The form of the question, and its nonce."""
        shown = self.see(f"/revoke?kind={kind}&id={id_}")
        fields = {name: html.unescape(value) for name, value in _HIDDEN.findall(shown)}
        form = {name: fields[name] for name in ("kind", "id", "sealed")}
        return form, re.search(r'data-nonce="([^"]*)"', shown)[1]

    def word(self, held, form, nonce, *, reason="it was taken over", signed=None, **changes):
        """The form with a passkey's word over what it says, with `signed` in place of parts of that."""
        told = {"by": self.name, "kind": form["kind"], "id": form["id"], "reason": reason, "nonce": nonce}
        told |= {"issuer": self.world.issuer} | (signed or {})
        expected = revoking.bound(
            told["issuer"], told["nonce"], by=told["by"], kind=told["kind"], id_=told["id"], reason=told["reason"]
        )
        body = held.body(expected, **changes)
        return form | {"reason": reason} | body

    def take_back(self, held, kind, id_, **changes):
        """Takes something back by passkey; the answer."""
        form, nonce = self.question(kind, id_)
        return self.post(f"{AT}/revocations", self.word(held, form, nonce, **changes))

    def asked(self, name, /, **query):
        """Members that the passkey is to say to the question about this act, and the seal that the page keeps."""
        self.get(f"{AT}/acts/{name}?{urlencode(query, doseq=True)}")
        found = re.search(r'data-said="([^"]*)"', self.page.text)
        if found is None:
            return None, None
        return json.loads(html.unescape(found[1])), dict(_HIDDEN.findall(self.page.text))["sealed"]

    def act(self, held, name, /, *, signed=None, changes=None, **query):
        """Does this by passkey; the answer. `signed` stands in place of parts of what the passkey says."""
        said, sealed = self.asked(name, **query)
        if said is None:
            return self.page
        body = held.body(acts.bound(said | (signed or {})), **(changes or {}))
        return self.post(f"{AT}/acts", {"sealed": sealed} | body)


def party():
    return relying_party(NAMED)
