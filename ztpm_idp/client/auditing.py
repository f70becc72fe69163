"""The ledger as people and monitors ask for it: search, single entries, checkpoints and proofs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote, urlencode

from capabilities.log import merkle, tree_head
from capabilities.statements.people import picture
from capabilities.values.errors import StatementError
from ztpm_idp.client.caller import Caller, ClientError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from capabilities.log.tree_head import EntryProof, TreeHead

MORE: Final = "ztpm-more-after"


@dataclass(frozen=True, slots=True)
class LedgerKeys:
    """Key set by which checkpoints of one ledger are verified.

    Attributes:
        issuer: of the trust bundle.
        keys: its raw ledger keys.
    """

    issuer: str
    keys: Collection[bytes]

    @property
    def origin(self) -> str:
        """Name of the ledger in its checkpoints."""
        return tree_head.origin_of(self.issuer)

    def open(self, text: str) -> TreeHead:
        """The tree head of a checkpoint of this ledger.

        Raises:
            StatementError: as `tree_head.open`.
        """
        return tree_head.open(text, self.origin, self.keys)


class AuditingCaller(Caller):
    """Requests about the ledger by one registered key; search and entries are for those who read it."""

    def checkpoint(self) -> str:
        """The signed checkpoint of the ledger as it is."""
        return self._send("GET", "/ledger/checkpoint", b"", None).text

    def entry(self, number: int) -> bytes:
        """One entry, as the ledger has it.

        Raises:
            ClientError: `ENTRY_UNKNOWN`.
        """
        return self._send("GET", f"/ledger/entries/{number}", b"", None).content

    def entry_proof(self, entry: int | str) -> EntryProof:
        """Proof that the entry with this number or hash stands in the ledger; nothing of it is verified yet.

        Raises:
            ClientError: `ENTRY_UNKNOWN`, `ANSWER_MALFORMED`.
        """
        name = "hash" if isinstance(entry, str) else "entry"
        answer = self._send("GET", f"/ledger/proofs/inclusion?{urlencode({name: entry})}", b"", None)
        try:
            return tree_head.read_proof(answer.text)
        except StatementError as error:
            raise ClientError("ANSWER_MALFORMED", answer.status_code, error.detail) from None

    def motion_picture(self, digest: str) -> str:
        """Text of the picture with this SHA-256 (hex), which a record or an ask names, read strictly.

        Raises:
            ClientError: `PICTURE_UNKNOWN`, `PICTURE_AWAITED`, or `ANSWER_MALFORMED` for another one, or for none.
        """
        answer = self._send("GET", f"/ledger/pictures/{quote(digest, safe='')}", b"", None)
        try:
            picture.read(answer.text)
        except StatementError as error:
            raise ClientError("ANSWER_MALFORMED", answer.status_code, error.detail) from None
        if picture.digest_of(answer.text) != digest:
            raise ClientError("ANSWER_MALFORMED", answer.status_code, "another picture")
        return answer.text

    def goes_on(self, held: TreeHead, ledger: LedgerKeys) -> str:
        """The newest checkpoint, once it is proven that its ledger begins with the held one.

        Raises:
            ClientError: `ENTRY_UNKNOWN` where the ledger became shorter, `ANSWER_MALFORMED`.
            StatementError: `STATEMENT_UNTRUSTED` where it became another, or is signed by another key.
        """
        found = self._json(self._send("GET", f"/ledger/proofs/consistency?old={held.size}", b"", None))
        try:
            path, signed = [bytes.fromhex(each) for each in found["path"]], str(found["checkpoint"])
        except (KeyError, ValueError, TypeError):
            raise ClientError("ANSWER_MALFORMED", 200) from None
        head = ledger.open(signed)
        merkle.check_consistency(held.size, head.size, path, held.root, head.root)
        return signed

    def search_rows(self, asked: Mapping[str, str | int], *, after: int = 0) -> Iterator[dict[str, Any]]:
        """Rows of the ledger's index that meet a question, in the ledger's order; page after page.

        Args:
            asked: kind, actor, agent, token, object, request, trace, since_ms, until_ms.
            after: number of the entry behind which it goes on.
        """
        for text in self._pages(asked, form="rows", after=after):
            try:
                yield from json.loads(text)["rows"]
            except (ValueError, KeyError, TypeError):
                raise ClientError("ANSWER_MALFORMED", 200) from None

    def search_pages(self, asked: Mapping[str, str | int], *, form: str, after: int = 0) -> Iterator[bytes]:
        """The entries that meet a question, as `lines` or `cef`; each page is of whole lines.

        Args:
            asked: as of `search_rows`.
            form: of the two.
            after: number of the entry behind which it goes on.
        """
        yield from self._pages(asked, form=form, after=after)

    def _pages(self, asked: Mapping[str, str | int], *, form: str, after: int) -> Iterator[bytes]:
        while True:
            query = urlencode({**asked, "form": form, "after": after, "most": 500})
            answer = self._send("GET", f"/ledger/search?{query}", b"", None)
            yield answer.content
            more = answer.headers.get(MORE)
            if more is None:
                return
            if not more.isdecimal() or not int(more) > after:
                raise ClientError("ANSWER_MALFORMED", answer.status_code, "a page that leads nowhere")
            after = int(more)
