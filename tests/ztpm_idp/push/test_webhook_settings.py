"""Webhooks of a configuration: their addresses are secrets, and nothing but HTTPS leaves the machine."""

from __future__ import annotations

import pytest
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.settings import check_settings
from ztpm_idp.webhook_settings import WEBHOOKS, WebhookSettings, load_webhooks

pytestmark = pytest.mark.clause("PSH-2")
GOOD = "https://hooks.example/services/T0/B0/s3cretXXXX"


def stated(**changes):
    given = {"name": "cell", "form": "slack", "url_file": "cell.url"} | changes
    return WebhookSettings(**{name: value for name, value in given.items() if value is not None})


def written(folder, text, mode=0o600):
    path = folder / "cell.url"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    path.chmod(mode)


def refused(folder, environment=None, **changes):
    with pytest.raises(SettingsError) as caught:
        load_webhooks([stated(**changes)], folder, environment or {})
    assert caught.value.setting.startswith("webhooks")
    assert "s3cret" not in str(caught.value)
    return caught.value.why


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o640])
def test_an_address_is_read_from_its_file(tmp_path, mode):
    written(tmp_path, GOOD + "\n", mode)
    (made,) = load_webhooks([stated()], tmp_path, {})
    assert (made.url, made.authorities is not None) == (GOOD, True)
    assert "s3cret" not in repr(made)


def test_an_address_is_read_from_the_environment(tmp_path):
    (made,) = load_webhooks([stated(url_file=None, url_variable="HOOK")], tmp_path, {"HOOK": GOOD})
    assert made.url == GOOD
    refused(tmp_path, {}, url_file=None, url_variable="HOOK")
    refused(tmp_path, {"HOOK": ""}, url_file=None, url_variable="HOOK")


@pytest.mark.parametrize(
    "text",
    [
        "http://hooks.example/s3cret",
        "http://127.0.0.1.example/s3cret",
        "http://10.0.0.1/s3cret",
        "ftp://hooks.example/s3cret",
        "file:///s3cret",
        "https:///s3cret",
        "https://user:s3cret@hooks.example/",
        "https://user@hooks.example/s3cret",
        "https://hooks.example/s3cret#more",
        "https://hooks.example:x/s3cret",
        "https://hooks.example:99999/s3cret",
        "https://[hooks.example/s3cret",
        "https://hooks.example/s3cret here",
        "https://hooks.example/s3cret\nhttps://other.example/",
        "https://hooks.example/s3cr\u00e9t",
        "https://hooks.example/" + "s3cret" * 400,
        "s3cret",
        "",
        b"\xff\xfes3cret",
    ],
)
def test_an_address_that_is_none_is_refused_without_being_told(tmp_path, text):
    written(tmp_path, text)
    refused(tmp_path)


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o666, 0o620])
def test_a_file_that_others_may_read_or_write_is_refused(tmp_path, mode):
    written(tmp_path, GOOD, mode)
    refused(tmp_path)


def test_a_file_that_is_missing_is_refused(tmp_path):
    refused(tmp_path)


@pytest.mark.parametrize("url", ["http://127.0.0.1:9/x", "http://localhost/x", "http://[::1]:9/x"])
def test_this_machine_is_told_in_the_clear(tmp_path, url):
    written(tmp_path, url)
    (made,) = load_webhooks([stated()], tmp_path, {})
    assert (made.url, made.authorities) == (url, None)
    (tmp_path / "ca.pem").write_text("")
    refused(tmp_path, ca_file="ca.pem")


@pytest.mark.parametrize("path", ["/", "", "/a/b", "/t%20t", "/" + "t" * 65])
def test_an_address_of_ntfy_ends_in_a_topic(tmp_path, path):
    written(tmp_path, "https://ntfy.example/topic?auth=s3cret")
    assert load_webhooks([stated(form="ntfy")], tmp_path, {})
    written(tmp_path, f"https://ntfy.example{path}?auth=s3cret")
    refused(tmp_path, form="ntfy")


@pytest.mark.parametrize("text", ["", "no certificate"])
def test_authorities_that_are_none_are_refused(tmp_path, text):
    written(tmp_path, GOOD)
    (tmp_path / "ca.pem").write_text(text)
    refused(tmp_path, ca_file="ca.pem")
    refused(tmp_path, ca_file="absent.pem")


SETTINGS = {"issuer": "http://127.0.0.1:8700/ztpm", "host": "127.0.0.1", "port": 8700,
            "database_url": "sqlite+aiosqlite:////x/idp.sqlite", "root_key_id": 1}  # fmt: skip
ROW = {"name": "cell", "form": "slack", "url_file": "cell.url"}


@pytest.mark.parametrize(
    "webhooks",
    [
        [ROW, ROW],
        [{**ROW, "name": f"w{n}"} for n in range(WEBHOOKS + 1)],
        [{**ROW, "form": "mail"}],
        [{**ROW, "name": "Cell"}],
        [{**ROW, "name": "../x"}],
        [{**ROW, "url_variable": "HOOK"}],
        [{"name": "cell", "form": "slack"}],
        [{**ROW, "url": GOOD}],
        [{**ROW, "url_file": ""}],
        [{**ROW, "details": "yes"}],
    ],
)
def test_settings_of_webhooks_that_are_none_are_refused(webhooks):
    with pytest.raises(SettingsError) as caught:
        check_settings(SETTINGS | {"webhooks": webhooks})
    assert caught.value.setting.startswith("webhooks")
    assert "s3cret" not in str(caught.value)
    assert check_settings(SETTINGS | {"webhooks": [ROW]}).webhooks == [WebhookSettings(**ROW)]
