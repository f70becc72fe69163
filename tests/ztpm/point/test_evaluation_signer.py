"""A gateway that knows no DPoP asks through the signer on its machine, in the name of its key."""

import asyncio
import json
from dataclasses import dataclass

import httpx2
import pytest
from pep.base.errors import ConfigError
from pep.point.evaluation_layer import ONE, SEVERAL, WELL_KNOWN
from tests.pep.point.asking_gateway import GATEWAY, ORIGIN, Asked, pouring

from capabilities.keys import keys
from ztpm.point.evaluation_signer import ANSWER_BYTES, LISTEN, EvaluationSigner, address_of, origin_of

HERE = f"http://{LISTEN}"


@dataclass
class Beside(Asked):
    """The enforcement point, and the signer beside its gateway."""

    def stock(self, content, *, path=ONE, method="POST", headers=None, upstream=None, key=None, base=HERE):
        """Response to a request as a stock gateway makes it: JSON, a secret of its own, no proof."""

        async def once():
            to_point = httpx2.AsyncClient(transport=upstream or httpx2.ASGITransport(app=self.layer))
            signer = EvaluationSigner(to_point, point=ORIGIN, key=key or self.key, host=LISTEN, clock=self.clock)
            sent = {"content-type": "application/json", "authorization": "Bearer secret", **(headers or {})}
            async with to_point, httpx2.AsyncClient(transport=httpx2.ASGITransport(app=signer)) as http:
                return await http.request(method, base + path, content=content, headers=sent)

        return asyncio.run(once())


@pytest.fixture
def beside(tmp_path):
    made = Beside(tmp_path)
    yield made
    made.gate.close()
    made.journal.close()


def test_a_stock_gateway_is_answered_as_its_registered_key(beside):
    body = json.dumps(beside.forwarded(pouring(7))).encode()
    answer = beside.stock(body, headers={"x-request-id": "q-1"})
    assert (answer.status_code, answer.json()["decision"]) == (200, True)
    assert (answer.headers["x-request-id"], answer.headers["cache-control"]) == ("q-1", "no-store")
    batch = {"evaluations": [pouring(1), beside.forwarded(pouring(2))]}
    told = beside.stock(json.dumps(batch).encode(), path=SEVERAL).json()["evaluations"]
    assert [each["decision"] for each in told] == [False, True]
    assert {each["body"]["asked"]["caller"] for each in beside.records("advice")} == {f"pep {GATEWAY}"}
    refused = beside.stock(json.dumps(pouring()).encode(), key=keys.generate())
    assert (refused.status_code, refused.json()["code"]) == (401, "PROOF_WRONG_KEY")


def test_a_refusal_comes_back_as_it_is(beside):
    refused = beside.stock(b'{"subject": NaN}', headers={"x-request-id": "q-2"})
    assert (refused.status_code, refused.json()["code"], refused.headers["x-request-id"]) == (400, "NOT_FINITE", "q-2")
    assert refused.headers["content-type"] == "application/problem+json"


def test_it_names_its_own_endpoints_and_answers_nothing_else(beside):
    told = beside.stock(b"", path=WELL_KNOWN, method="GET").json()
    assert told["access_evaluation_endpoint"] == HERE + ONE
    assert beside.stock(b"", path="/mcp").status_code == 404
    assert beside.stock(b"", method="GET").status_code == 405
    body = json.dumps(beside.forwarded(pouring())).encode()
    assert beside.stock(body, base="http://evil.example:8931").status_code == 421, "a name that was led here"
    assert beside.kinds() == []


@pytest.mark.parametrize("defect", ["down", "long"])
def test_no_answer_is_no_decision(beside, defect):
    def there(request):
        if defect == "down":
            raise httpx2.ConnectError("down")
        return httpx2.Response(200, content=b" " * (ANSWER_BYTES + 1))

    answer = beside.stock(json.dumps(pouring()).encode(), upstream=httpx2.MockTransport(there))
    assert (answer.status_code, answer.json()["code"]) == (502, "POINT_UNREACHABLE")
    assert "decision" not in answer.json()


@pytest.mark.parametrize(
    "point", ["", "plant.example", "http://plant.example", "https://plant.example/mcp", "https://a@plant.example",
              "ftp://plant.example", "https://plant.example?q"],
)  # fmt: skip
def test_it_sends_to_an_origin_alone_and_nothing_in_the_clear(point):
    with pytest.raises(ConfigError):
        origin_of(point)
    assert origin_of("https://plant.example/") == "https://plant.example"
    assert origin_of("http://127.0.0.1:8900") == "http://127.0.0.1:8900"


@pytest.mark.parametrize(
    "listen", ["", "8931", ":8931", "0.0.0.0:8931", "plant.example:1", "127.0.0.1:0", "127.0.0.1:x"]
)
def test_it_listens_on_this_machine_alone(listen):
    with pytest.raises(ConfigError):
        address_of(listen)
    assert address_of(LISTEN) == ("127.0.0.1", 8931)
    assert address_of("[::1]:1") == ("::1", 1)
