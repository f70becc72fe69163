"""Keys of access tokens are rotated while the provider serves; what does not hold together changes nothing."""

from __future__ import annotations

import jwt
import pytest
from tests.ztpm_idp.oauth.speaking import StockClient, looked_at
from tests.ztpm_idp.test_settings import KEY_FILES, write_config
from tests.ztpm_idp.world import World

from capabilities.keys import keys
from ztpm_idp import watching
from ztpm_idp.client import ClientError
from ztpm_idp.keys import oauth_keys
from ztpm_idp.settings import load_keys, load_settings


class Configured:
    """A provider with its configuration on disk, and the watch over that."""

    def __init__(self, folder):
        self.folder, self.config = folder, write_config(folder)
        self.plain = self.config.read_text()
        self.made = {}
        self.state(self.key("oauth-1"))

    def key(self, name):
        self.made[name] = key = keys.generate()
        path = self.folder / f"{name}.key"
        path.touch(0o600)
        path.write_bytes(keys.to_pem(key, b"secret"))
        return f"{name}.key"

    def state(self, *names, more=""):
        listed = ", ".join(f'"{name}"' for name in names)
        self.config.write_text(f"oauth_key_files = [{listed}]\n{self.plain}\n{more}")

    def kid(self, name):
        return keys.thumbprint(keys.public_raw(self.made[name]))


@pytest.fixture
def configured(tmp_path):
    return Configured(tmp_path)


@pytest.fixture
def world(tmp_path, configured):
    settings = load_settings(configured.config)
    own = load_keys(settings, tmp_path, "secret")
    (tmp_path / "world").mkdir()
    access = oauth_keys.load(settings.oauth_key_files, tmp_path, own, "secret")
    with World(tmp_path / "world", idp_keys=own, oauth_keys=access) as made:
        made.pep()
        (made.watch,) = watching.watching(settings, configured.config, "secret", own)(made.provider)
        yield made


def look(world):
    world.on_loop(world.watch.look())
    with world.anonymous() as http:
        published = [key["kid"] for key in http.get("/oauth/jwks").json()["keys"]]
        return published, http.get("/readyz").json().get("faults", {})


def test_a_key_is_published_signs_and_goes_without_a_restart(world, configured):
    viewer = StockClient(world, "viewer", key=keys.generate())
    viewer.register()
    viewer.mandate()

    def token():
        answer = viewer.credentials()
        assert answer.status_code == 200, answer.text
        text = answer.json()["access_token"]
        return text, jwt.get_unverified_header(text)["kid"]

    new = configured.key("oauth-2")
    first, second = configured.kid("oauth-1"), configured.kid("oauth-2")
    old, signed_by = token()
    assert signed_by == first
    configured.state("oauth-1.key", new)
    assert look(world) == ([first, second], {})
    assert token()[1] == first
    configured.state(new, "oauth-1.key")
    assert look(world) == ([second, first], {})
    fresh, signed_by = token()
    assert signed_by == second
    assert looked_at(world, old)["active"] is True
    assert looked_at(world, fresh)["active"] is True
    configured.state(new)
    assert look(world) == ([second], {})
    assert looked_at(world, old) == {"active": False}
    assert looked_at(world, fresh)["active"] is True
    # A key that went is nobody's.
    configured.state("oauth-1.key")
    assert look(world) == ([first], {})
    with pytest.raises(ClientError) as refused:
        world.people["alice"].register_person(
            "eve", "Eve", keys.public_raw(configured.made["oauth-2"]), ("sponsor",)
        )  # fmt: skip
    assert refused.value.code == "KEY_IN_USE"


REFUSED = [
    (["oauth-1.key", "absent.key"], "", "oauth_key_files"),
    ([KEY_FILES[2]], "", "oauth_key_files"),
    (["oauth-1.key", "oauth-1.key"], "", "oauth_key_files"),
    ([], "", "oauth_key_files"),
    (["oauth-2.key"], "port = ", "config"),
    (["oauth-2.key"], "[rates]\nlogin_a_minute = 7\n", "rates"),
    (["oauth-2.key"], "[rates]\nlogin_a_minute = 0\n", "rates.login_a_minute"),
]


def test_a_configuration_that_is_not_taken_leaves_the_keys_and_is_told(world, configured):
    before = [configured.kid("oauth-1")]
    configured.key("oauth-2")
    for names, more, setting in REFUSED:
        configured.state(*names, more=more)
        published, faults = look(world)
        assert published == before
        assert faults["config"].startswith(f"{setting}: ")
    configured.state("oauth-1.key")
    assert look(world) == (before, {})
