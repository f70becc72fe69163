"""Sixty forgeries of an attestation, each wrong in one way, tried at the wire of one provider.

`python -m tests.ztpm_idp.platforms.forgeries` tries them all, and says last how many were accepted.
"""

from __future__ import annotations


import hashlib
import sys
import tempfile
from pathlib import Path

import jwt
import rfc8785
from msgspec import structs
from capabilities.statements.workload import Cluster, Platform
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID
from tests.ztpm_idp.platforms.spire import Authority, Kubernetes, Spire, _usage, curve_key, rsa_key
from tests.ztpm_idp.world import ISSUER, START_S, World

from capabilities.keys import keys, signatures
from capabilities.statements import attestation, platform_keys, release, statement_form, x509_svid
from ztpm_idp.client import Agent, ClientError

NOW = int(START_S)
DOMAIN, OTHER = "prod.example", "other.example"
DIGESTS = [bytes([n]) * 32 for n in range(4)]
MEASUREMENT = release.measurement(*DIGESTS)
PATH = "agents/planner"
KINDS = ("key", "bearer", "cluster", "x509", "release")


class Scene:
    """A provider that trusts a SPIRE server, a cluster and a publisher, and one agent for each kind of evidence."""

    def __init__(self, folder: Path):
        self.spire, self.other = Spire(DOMAIN, NOW), Spire(OTHER, NOW)
        self.cluster, self.publisher = Kubernetes(NOW), keys.generate()
        self.world = World(folder, publishers={"acme": frozenset({keys.public_raw(self.publisher)})})
        self.sessions = []

    def __enter__(self):
        self.world.__enter__()
        bundle = platform_keys.bundle(self.spire.bundle())
        provider = self.world.provider
        provider.trust_platform("spire", Platform(DOMAIN, bundle.keys, bundle.authorities))
        account_keys, _ = platform_keys.key_set(self.cluster.jwks())
        provider.trust_platform("k8s", Cluster("east", self.cluster.issuer, account_keys, 3_607))
        workloads = {"bearer": f"spiffe://{DOMAIN}/{PATH}", "cluster": "k8s://east/robots/planner"}
        self.names = {"key": "", "x509": f"spiffe://{DOMAIN}/{PATH}", "release": ""} | workloads
        for kind in (*KINDS, "thief"):
            self.register(kind, self.names.get(kind, f"spiffe://{DOMAIN}/agents/thief"))
        self.svid_key = curve_key()
        return self

    def __exit__(self, *error):
        self.world.__exit__(*error)

    def register(self, name, workload):
        world = self.world
        world.private[name] = keys.generate()
        world.people["alice"].register_agent(
            name, keys.public_raw(world.private[name]), software_digest=MEASUREMENT.hex(), model="m", role="r",
            workload=workload,
        )  # fmt: skip
        world.agents[name] = world.caller(Agent, name, MEASUREMENT)

    def thumbprint(self, name):
        return keys.thumbprint(keys.public_raw(self.world.private[name]))

    def beside(self, kind, nonce, **how):
        """Text that is handed in besides, right unless `how` says otherwise."""
        match kind:
            case "key":
                return ""
            case "bearer":
                return self.spire.token(PATH, ISSUER, jti=nonce, **how)
            case "cluster":
                return self.cluster.token("robots", "planner", ISSUER, **how)
            case "x509":
                return self.proof(nonce, **how)
            case "release":
                return self.manifest(**how)
        raise AssertionError(kind)

    def proof(self, nonce, *, chain=None, key=None, **changes):
        chain = self.spire.authority.svid(PATH, self.svid_key) if chain is None else chain
        said = {"audience": ISSUER, "nonce": nonce, "key_thumbprint": self.thumbprint("x509"), "at": NOW} | changes
        return x509_svid.prove(chain, key or self.svid_key, **said)

    def manifest(self, *, key=None, **changes):
        said = release.Release("acme", "planner-1.4", *DIGESTS, NOW - 10, NOW + 1_000)
        return release.sign(structs.replace(said, **changes), key or self.publisher)

    def evidence(self, kind, beside=None, *, signer=None, nonce=None, **changes):
        """The agent's signed statement with what is handed in besides."""
        agent = self.world.agents[kind]
        nonce = agent.nonce() if nonce is None else nonce
        text = self.beside(kind, nonce) if beside is None else beside(nonce)
        stated = attestation.Evidence(
            kind, self.thumbprint(kind), nonce, "", bytes(32), MEASUREMENT, NOW, text
        )  # fmt: skip
        key = self.world.private[kind] if signer is None else signer
        if signer is not None:
            changes.setdefault("key_thumbprint", keys.thumbprint(keys.public_raw(signer)))
        return attestation.sign(structs.replace(stated, **changes), key)

    def hand_in(self, kind, evidence):
        """The code of the refusal, or "" where it was accepted."""
        try:
            self.world.agents[kind]._post(f"/agents/{kind}/attestations", {"evidence": evidence})
        except ClientError as error:
            return error.code
        return ""

    def kinds(self):
        """Kinds as which evidence was accepted, by agent, in the ledger."""
        import json  # noqa: PLC0415

        lines = map(json.loads, self.world.people["alice"].export_ledger().splitlines())
        return {
            line["body"]["agent"]: line["body"]["evidence_kind"]
            for line in lines
            if line.get("kind") == "agent-attested"
        }


def _resigned(token: str) -> str:
    """The same ES256 token under its other signature: s of the other half."""
    head, _, raw = token.rpartition(".")
    signature = keys.unb64u(raw)
    s = signatures.P256_N - int.from_bytes(signature[32:], "big")
    return f"{head}.{keys.b64u(signature[:32] + s.to_bytes(32, 'big'))}"


def _foreign_header(token: str, key, **more) -> str:
    claims = jwt.decode(token, options={"verify_signature": False})
    return jwt.encode(claims, key, algorithm="ES256", headers={"typ": "JWT"} | more)


def of_the_agent(s: Scene):
    """The agent's own statement, and its nonce."""
    mallory = keys.generate()
    yield "key", "signed by a stranger", lambda: s.evidence("key", signer=mallory)
    yield "key", "signed by another agent", lambda: s.evidence("key", signer=s.world.private["thief"])
    yield "key", "of another agent's key", lambda: statement_as(s, "key", key=s.thumbprint("thief"))
    yield "key", "about another agent", lambda: s.evidence("key", agent="thief")
    yield "key", "other software", lambda: s.evidence("key", measurement=bytes(32))
    yield "key", "for a delegator", lambda: s.evidence("key", delegator="alice")
    yield "key", "for another request", lambda: s.evidence("key", request_digest=hashlib.sha256(b"x").digest())
    yield "key", "a nonce that nobody gave", lambda: s.evidence("key", nonce="n" * 32)
    yield "key", "another agent's nonce", lambda: s.evidence("key", nonce=s.world.agents["thief"].nonce())
    yield "key", "from before its nonce", lambda: s.evidence("key", at=NOW - 60)
    yield "key", "from the future", lambda: s.evidence("key", at=NOW + 60)
    yield "key", "the signature of another statement", lambda: swapped(s.evidence("key"), s.evidence("key"))
    yield "key", "a statement of another kind", lambda: statement_as(s, "key", kind="vote")
    yield "key", "what is handed in is of no kind", lambda: s.evidence("key", lambda _: "a.b.c")


def statement_as(s: Scene, agent: str, *, kind="attestation", **changes) -> str:
    text = s.evidence(agent)
    claims = jwt.decode(text, options={"verify_signature": False})
    return statement_form.sign(kind, claims | changes, s.world.private[agent])


def swapped(text: str, other: str) -> str:
    return f"{text.rpartition('.')[0]}.{other.rpartition('.')[2]}"


def of_a_token(s: Scene):
    """A JWT-SVID."""
    spire, mallory = s.spire, curve_key()

    def made(**how):
        return lambda: s.evidence("bearer", lambda nonce: spire.token(how.pop("path", PATH), ISSUER, jti=nonce, **how))

    yield "bearer", "signed by a stranger", made(key=mallory)
    yield "bearer", "by the key of another trust domain", made(key=s.other.jwt_key)
    yield "bearer", "by the X.509 authority's key", made(key=spire.authority.key)
    yield "bearer", "another workload's", made(path="agents/thief")
    yield "bearer", "of a workload below", made(path=PATH + "/x")
    yield "bearer", "of another trust domain", made(sub=f"spiffe://{OTHER}/{PATH}")
    yield "bearer", "of a trust domain that begins alike", made(sub=f"spiffe://{DOMAIN}.evil/{PATH}")
    yield "bearer", "for another audience", made(aud=[ISSUER + "/x"])
    yield "bearer", "for another audience as well", made(aud=[ISSUER, "https://elsewhere.example"])
    yield "bearer", "for no audience", made(aud=[])
    yield "bearer", "over", made(iat=NOW - 300, exp=NOW)
    yield "bearer", "from the future", made(iat=NOW + 60, exp=NOW + 100)
    yield "bearer", "too long", made(lifetime_s=301)
    yield "bearer", "without an end", made(exp=None)
    yield "bearer", "a key id of nobody", made(header={"kid": "x"})
    yield "bearer", "a key by the header", made(key=mallory, header={"jwk": {"kty": "EC"}})
    yield "bearer", "a key's address in the header", made(key=mallory, header={"jku": "https://evil.example/jwks"})
    yield "bearer", "a certificate's address in the header", made(key=mallory, header={"x5u": "https://evil.example"})
    yield "bearer", "an issuer of its own", made(iss="https://evil.example")
    yield "bearer", "a key without a measurement", made(cnf={"jkt": s.thumbprint("bearer")})
    yield "bearer", "bound to another key", made(cnf={"jkt": s.thumbprint("thief")}, measurement=MEASUREMENT.hex())
    yield "bearer", "measured other software", made(cnf={"jkt": s.thumbprint("bearer")}, measurement="00" * 32)
    used, again = spire.token(PATH, ISSUER, jti="used"), spire.token(PATH, ISSUER, jti="again")

    def once(token, second):
        assert s.hand_in("bearer", s.evidence("bearer", lambda _: token)) == ""
        return s.evidence("bearer", lambda _: second)

    yield "bearer", "shown before", lambda: once(used, used)
    yield "bearer", "shown before, under its other signature", lambda: once(again, _resigned(again))
    yield "thief", "stolen from another agent", lambda: s.evidence("thief", lambda n: spire.token(PATH, ISSUER, jti=n))
    yield "key", "of an agent without a workload", lambda: s.evidence("key", lambda n: spire.token(PATH, ISSUER, jti=n))


def of_an_account(s: Scene):
    """A service account's token."""
    cluster, elsewhere = s.cluster, Kubernetes(NOW, name="elsewhere")

    def made(**how):
        namespace, account = how.pop("of", ("robots", "planner"))
        return lambda: s.evidence("cluster", lambda _: cluster.token(namespace, account, ISSUER, **how))

    yield "cluster", "signed by another cluster", made(key=elsewhere.key)
    yield "cluster", "of another issuer", made(iss="https://evil.example")
    yield "cluster", "another account's", made(of=("robots", "thief"))
    yield "cluster", "the account of another namespace", made(of=("default", "planner"))
    yield "cluster", "two accounts in one token", made(sub="system:serviceaccount:robots:planner", **{
        "kubernetes.io": {"namespace": "default", "serviceaccount": {"name": "planner"}}})  # fmt: skip
    yield "cluster", "of a person", made(sub="alice")
    yield "cluster", "for the cluster's own API", made(aud=["https://kubernetes.default.svc"])
    yield "cluster", "over", made(iat=NOW - 3_607, exp=NOW, nbf=NOW - 3_607)
    yield "cluster", "without an end, as of old", made(exp=None)
    yield "cluster", "a JWT-SVID instead", lambda: s.evidence("cluster", lambda n: s.spire.token(PATH, ISSUER, jti=n))
    text = cluster.token("robots", "planner", ISSUER)

    def twice():
        assert s.hand_in("cluster", s.evidence("cluster", lambda _: text)) == ""
        return s.evidence("cluster", lambda _: text)

    yield "cluster", "shown before", twice


def of_a_certificate(s: Scene):
    """An X.509-SVID, and the proof of its key."""
    authority, key = s.spire.authority, s.svid_key
    strange, mallory = Authority(DOMAIN, NOW), curve_key()
    below, unsigned = Authority(DOMAIN, NOW, above=authority), Authority(DOMAIN, NOW, above=strange)

    def made(**how):
        return lambda: s.evidence("x509", lambda nonce: s.proof(how.pop("nonce", nonce), **how))

    own = authority.svid(PATH, key)
    theirs = authority.svid("agents/thief", mallory)
    yield "x509", "of an authority of the same name", made(chain=strange.svid(PATH, key))
    yield "x509", "of another trust domain's authority", made(chain=s.other.authority.svid(PATH, key))
    yield "x509", "below a stranger", made(chain=unsigned.svid(PATH, key))
    yield (
        "x509",
        "below a stranger, beside a genuine authority",
        made(chain=[*unsigned.svid(PATH, key), below.certificate]),
    )
    yield "x509", "a genuine certificate, another key's proof", made(chain=own, key=mallory)
    yield "x509", "the signer's certificate behind a genuine one", made(chain=[*own, *theirs], key=mallory)
    yield "x509", "another workload's", made(chain=theirs, key=mallory)
    yield "x509", "signed by a workload", made(chain=[child(theirs[0], mallory, key), *theirs])
    yield "x509", "over", made(chain=authority.svid(PATH, key, lifetime_s=-1))
    yield "x509", "of tomorrow", made(chain=authority.svid(PATH, key, begun_s=-60))
    yield "x509", "two names", made(chain=authority.svid(
        PATH, key, uris=[f"spiffe://{DOMAIN}/{PATH}", f"spiffe://{DOMAIN}/agents/thief"]))  # fmt: skip
    yield "x509", "the trust domain alone", made(chain=authority.svid(PATH, key, uris=[f"spiffe://{DOMAIN}"]))
    yield (
        "x509",
        "a name of another trust domain",
        made(chain=authority.svid(PATH, key, uris=[f"spiffe://{OTHER}/{PATH}"])),
    )
    yield (
        "x509",
        "may sign certificates",
        made(chain=authority.svid(PATH, key, usage=_usage(digital_signature=True, key_cert_sign=True))),
    )
    yield "x509", "for servers alone", made(chain=authority.svid(PATH, key, extended=[ExtendedKeyUsageOID.SERVER_AUTH]))
    yield "x509", "over another nonce", made(nonce="n" * 32)
    yield "x509", "for another audience", made(audience=ISSUER + "/x")
    yield "x509", "about another agent's key", made(key_thumbprint=s.thumbprint("thief"))
    yield "x509", "old", made(at=NOW - 66)
    yield "x509", "from the future", made(at=NOW + 6)

    def replayed():
        evidence = s.evidence("x509")
        assert s.hand_in("x509", evidence) == ""
        return evidence

    yield "x509", "the same evidence again", replayed
    yield "cluster", "of an agent of a cluster", lambda: s.evidence("cluster", s.proof)
    yield "x509", "no chain", lambda: s.evidence("x509", lambda n: bare(s, n, chain=[]))
    yield (
        "x509",
        "a chain in the place of a key's address",
        lambda: s.evidence("x509", lambda n: bare(s, n, jku="https://evil.example")),
    )


def child(parent, parent_key, key):
    """A certificate that a workload's own certificate signed."""
    authority = Authority(DOMAIN, NOW)
    authority.key, authority.certificate = parent_key, parent
    return authority.svid(PATH, key)[0]


def bare(s: Scene, nonce: str, *, chain=None, **header) -> str:
    import base64  # noqa: PLC0415

    own = s.spire.authority.svid(PATH, s.svid_key) if chain is None else chain
    der = [base64.b64encode(one.public_bytes(Encoding.DER)).decode() for one in own]
    payload = {"aud": ISSUER, "cnf": {"jkt": s.thumbprint("x509")}, "iat": NOW, "nonce": nonce}
    engine = jwt.PyJWS()
    return engine.encode(
        rfc8785.dumps(payload), s.svid_key, algorithm="ES256", headers={"typ": x509_svid.TYPE, "x5c": der} | header
    )  # fmt: skip


def of_a_release(s: Scene):
    """A publisher's release."""
    mallory = keys.generate()

    def made(**how):
        return lambda: s.evidence("release", lambda _: s.manifest(**how))

    yield "release", "signed by a stranger", made(key=mallory)
    yield "release", "signed by the agent", made(key=s.world.private["release"])
    yield "release", "of another publisher by name", made(publisher="apex")
    yield "release", "over", made(not_after=NOW)
    yield "release", "of tomorrow", made(at=NOW + 60)
    for n, part in enumerate(("software", "model", "prompt", "tools")):
        yield "release", f"with another {part}", made(**{part: bytes([n + 9]) * 32})


PARTS = (of_the_agent, of_a_token, of_an_account, of_a_certificate, of_a_release)


def tried(scene: Scene):
    """Every forgery: its kind, what is wrong, and the code of its refusal ("" where it was accepted)."""
    for part in PARTS:
        for kind, what, forged in part(scene):
            yield f"{part.__name__}: {what}", kind, scene.hand_in(kind, forged())


def main() -> int:
    """Tries them all; the exit status."""
    with tempfile.TemporaryDirectory() as folder, Scene(Path(folder)) as scene:
        for kind in KINDS:
            assert scene.hand_in(kind, scene.evidence(kind)) == "", kind
        assert scene.kinds() == {k: "bearer" if k == "cluster" else k for k in KINDS}
        found = list(tried(scene))
    accepted = [what for what, _, code in found if not code]
    for what, _, code in found:
        sys.stdout.write(f"{code or 'ACCEPTED':24} {what}\n")
    sys.stdout.write(f"attestation forgeries: {len(found)} tried, {len(accepted)} accepted\n")
    return 1 if accepted or len(found) < 60 else 0


if __name__ == "__main__":
    assert rsa_key
    sys.exit(main())
