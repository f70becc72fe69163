"""Settings of Web Push: a contact, and the push services that a browser may name, each in one spelling."""

from __future__ import annotations

import pytest
from tests.ztpm_idp.push.test_webhook_settings import SETTINGS
from ztpm_idp.settings import check_settings
from ztpm_idp.web_push_settings import ENDPOINT_BYTES, ServicePlace, WebPushSettings, load_web_push, place_of

from ztpm_idp.keys.key_files import SettingsError

pytestmark = pytest.mark.clause("PSH-8")
CONTACT = "mailto:ops@works.example"
STATED = WebPushSettings(contact=CONTACT, own_services=["push.works.example:8443", "10.0.0.7:443"])


@pytest.mark.parametrize(
    ("endpoint", "place"),
    [
        ("https://fcm.googleapis.com/fcm/send/abc:APA91b", ServicePlace.PUBLIC),
        ("https://updates.push.services.mozilla.com/wpush/v2/gAAA", ServicePlace.PUBLIC),
        ("https://web.push.apple.com/QGu", ServicePlace.PUBLIC),
        ("https://wns2-par02p.notify.windows.com/w/?token=BQY%3d", ServicePlace.PUBLIC),
        ("https://fcm.googleapis.com:443/fcm/send/abc", ServicePlace.PUBLIC),
        ("https://push.works.example:8443/one", ServicePlace.OWN),
        ("https://10.0.0.7/one", ServicePlace.OWN),
        ("https://push.works.example/one", None),
        ("https://fcm.googleapis.com:8443/one", None),
        ("http://fcm.googleapis.com/one", None),
        ("https://FCM.googleapis.com/one", None),
        ("https://fcm.googleapis.com./one", None),
        ("https://fcm.googleapis.com", None),
        ("https://fcm.googleapis.com/", None),
        ("https://notify.windows.com/one", None),
        ("https://evilnotify.windows.com/one", None),
        ("https://.notify.windows.com/one", None),
        ("https://user@fcm.googleapis.com/one", None),
        ("https://evil.example\\@fcm.googleapis.com/one", None),
        ("https://evil.example/fcm.googleapis.com/one", None),
        ("https://evil.example#fcm.googleapis.com/one", None),
        ("https://fcm.googleapis.com/one#two", None),
        ("https://fcm.googleapis.com:/one", None),
        ("https://fcm.googleapis.com:0443/one", None),
        ("https://fcm.googleapis.com/o ne", None),
        ("https://fcm.googleapis.com/" + "a" * ENDPOINT_BYTES, None),
        ("", None),
    ],
)
def test_an_endpoint_is_at_a_stated_service_or_nowhere(endpoint, place):
    assert place_of(endpoint, STATED) is place


@pytest.mark.parametrize(
    ("changes", "setting"),
    [
        ({"contact": "ops@works.example"}, "web_push.contact"),
        ({"contact": "http://works.example"}, "web_push.contact"),
        ({"services": ["https://fcm.googleapis.com"]}, "web_push.services.0"),
        ({"services": ["*"]}, "web_push.services.0"),
        ({"services": ["googleapis"]}, "web_push.services.0"),
        ({"own_services": ["push.works.example"]}, "web_push.own_services.0"),
        ({"unknown": 1}, "web_push.unknown"),
    ],
)
def test_a_setting_that_is_not_one_is_named(changes, setting):
    with pytest.raises(SettingsError) as caught:
        check_settings(SETTINGS | {"web_push": {"contact": CONTACT} | changes})
    assert caught.value.setting == setting


def test_it_is_off_unless_it_is_stated_and_needs_a_service(tmp_path):
    assert check_settings(SETTINGS).web_push is None
    assert load_web_push(None, tmp_path) is None
    with pytest.raises(SettingsError):
        load_web_push(WebPushSettings(contact=CONTACT, services=[]), tmp_path)
    with pytest.raises(SettingsError):
        load_web_push(WebPushSettings(contact=CONTACT, ca_file="none.pem"), tmp_path)
    assert load_web_push(STATED, tmp_path).stated == STATED
