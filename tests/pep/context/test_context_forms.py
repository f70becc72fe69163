"""Forms: closed, strict, and with what a body of each asks for."""

from __future__ import annotations

from typing import Any

import pytest
from pep.base.errors import ConfigError, PepFault
from pep.context.forms import ASKED, Form, FormBody, Forms, RequestedOperation, asks_nothing
from pydantic import BaseModel


class Place(FormBody):
    x_um: int
    y_um: int


class Put(FormBody):
    part: str
    at: tuple[Place, ...]
    slow: bool = False


class Loose(BaseModel):
    part: str


class LooseInside(FormBody):
    part: Loose


class Open(FormBody):
    parts: dict[str, int]


class Anything(FormBody):
    part: Any


FORMS = Forms([Form("put/1", Put, lambda put: (RequestedOperation("ur3e", "gripper_move"),) * len(put.at))])


def test_a_body_of_its_form_is_read():
    read = FORMS.read("put/1", b'{"at":[{"x_um":1,"y_um":-2}],"part":"red"}')
    assert read.body == Put(part="red", at=(Place(x_um=1, y_um=-2),))
    assert read.asked == (RequestedOperation("ur3e", "gripper_move"),)


@pytest.mark.parametrize(
    ("schema", "body"),
    [
        ("put/2", b'{"at":[],"part":"red"}'),
        ("put/1", b'{"at":[]}'),
        ("put/1", b'{"at":[],"part":"red","more":1}'),
        ("put/1", b'{"at":[{"x_um":1,"y_um":2,"z_um":3}],"part":"red"}'),
        ("put/1", b'{"at":[{"x_um":"1","y_um":2}],"part":"red"}'),
        ("put/1", b'{"at":[{"x_um":1.5,"y_um":2}],"part":"red"}'),
        ("put/1", b'{"at":[{"x_um":true,"y_um":2}],"part":"red"}'),
        ("put/1", b'{"at":[],"part":7}'),
        ("put/1", b'{"at":[],"part":"red","slow":1}'),
        ("put/1", b'{"at":[],"part":null}'),
        ("put/1", b"[]"),
        ("put/1", b"not JSON"),
        ("put/1", b"\xff"),
    ],
)
def test_a_body_that_is_not_of_its_form_is_none(schema, body):
    assert FORMS.read(schema, body) is None


@pytest.mark.parametrize("body", [Loose, LooseInside, Open])
def test_a_form_that_is_not_closed_is_refused(body):
    with pytest.raises(ConfigError) as caught:
        Forms([Form("loose/1", body, asks_nothing)])
    assert caught.value.code is PepFault.CONFIG_INVALID


def test_a_name_stands_for_one_form():
    with pytest.raises(ConfigError) as caught:
        Forms([Form("put/1", Put, asks_nothing), Form("put/1", Place, asks_nothing)])
    assert caught.value.code is PepFault.CONFIG_INVALID


def test_what_its_own_form_cannot_read_is_none():
    def fail(_):
        raise ZeroDivisionError

    body = b'{"at":[],"part":"red"}'
    assert Forms([Form("put/1", Put, fail)]).read("put/1", body) is None
    assert (
        Forms([Form("put/1", Put, lambda _: (RequestedOperation("ur3e", "stop"),) * (ASKED + 1))]).read("put/1", body)
        is None
    )
    assert (
        Forms([Form("put/1", Put, lambda _: (RequestedOperation("ur3e", "stop"),) * ASKED)]).read("put/1", body)
        is not None
    )
    assert Forms().read("put/1", body) is None
    assert asks_nothing(Put(part="red", at=())) == ()


def test_a_member_of_any_kind_is_still_named():
    assert Forms([Form("any/1", Anything, asks_nothing)]).read("any/1", b'{"part":[1,"a"],"more":1}') is None
