"""Further keys of people, and changes of people, in their tables."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.changes import RECOVERY_LIFETIME_MS, Change, ChangeKind, ChangeState, Word
from ztpm_idp.domain.events import ChangeAnswered, ChangeEnded, ChangeProposed, KeyAdded, RolesChanged
from ztpm_idp.domain.parties import PersonRole, Standing
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sqlalchemy.ext.asyncio import AsyncConnection


PeopleEvent = KeyAdded | RolesChanged | ChangeProposed | ChangeAnswered | ChangeEnded


class People:
    """Access of one transaction to people's further keys and to changes of people."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def owners(self, keys: Iterable[bytes]) -> dict[bytes, str]:
        """The people who have these further keys, ended or not."""
        c = t.person_keys.c
        found = await self._connection.execute(sa.select(c.key, c.person).where(c.key.in_(sorted(keys))))
        return {bytes(key): person for key, person in found}

    async def passkey(self, credential: str) -> tuple[str, bytes] | None:
        """The person who has the passkey with this credential, and its raw key; ended or not."""
        c = t.person_keys.c
        found = (
            await self._connection.execute(sa.select(c.person, c.key).where(c.credential == credential))
        ).one_or_none()
        return None if found is None else (found.person, bytes(found.key))

    async def administrators(self) -> frozenset[str]:
        """The active administrators."""
        return await self._with_role(PersonRole.ADMIN)

    async def approvers(self) -> int:
        """Number of active approvers."""
        return len(await self._with_role(PersonRole.APPROVER))

    async def _with_role(self, role: PersonRole) -> frozenset[str]:
        p = t.parties.c
        found = await self._connection.execute(
            sa.select(p.id, t.people.c.roles)
            .join_from(t.people, t.parties, p.id == t.people.c.id)
            .where(p.standing == Standing.ACTIVE.value)
        )
        return frozenset(id_ for id_, roles in found if role.value in roles)

    async def change(self, change_id: str) -> Change | None:
        """The change, when there is one."""
        found = await self._changes(t.changes.c.change_id == change_id)
        return found[0] if found else None

    async def open_changes(self, *, at_ms: int) -> tuple[Change, ...]:
        """Changes that may be open at this time, oldest first."""
        c = t.changes.c
        return tuple(await self._changes(sa.and_(c.ended.is_(None), c.proposed_ms > at_ms - RECOVERY_LIFETIME_MS)))

    async def due(self, key: bytes, *, at_ms: int) -> Change | None:
        """The recovery with this key that takes effect now."""
        waiting = await self._changes(sa.and_(t.changes.c.key == key, t.changes.c.ended.is_(None)))
        return next((change for change in waiting if change.due(at_ms)), None)

    async def write(self, event: PeopleEvent, *, at_ms: int) -> None:
        """The event is in its table."""
        match event:
            case KeyAdded(person=person, key=key, credential=credential):
                statement: Any = sa.insert(t.person_keys).values(
                    key=key, thumbprint=thumbprint(key), person=person, added_ms=at_ms, credential=credential or None
                )
            case RolesChanged(person=person, roles=roles):
                statement = (
                    sa.update(t.people)
                    .where(t.people.c.id == person)
                    .values(roles=sorted(role.value for role in roles))
                )
            case ChangeProposed(change=change):
                if change.credential:
                    # The enrolment that made it is over.
                    c = t.enrolments.c
                    made = sa.and_(c.person == change.person, c.key == change.key)
                    await self._connection.execute(sa.delete(t.enrolments).where(made))
                statement = sa.insert(t.changes).values(
                    change_id=change.change_id,
                    kind=(ChangeKind.PERSON if change.kind is ChangeKind.ROLES else change.kind).value,
                    person=change.person,
                    proposed_by=change.by,
                    proposed_ms=change.proposed_ms,
                    name=change.name,
                    roles=sorted(role.value for role in change.roles),
                    key=change.key,
                    reason=change.reason,
                    login=change.login,
                    credential=change.credential or None,
                    by_passkey=change.by_passkey,
                )
            case ChangeAnswered(change_id=change_id, by=by, word=word):
                statement = sa.insert(t.change_words).values(
                    change_id=change_id, person=by, word=word.value, said_ms=at_ms
                )  # fmt: skip
            case ChangeEnded(change_id=change_id, state=state):
                statement = sa.update(t.changes).where(t.changes.c.change_id == change_id).values(ended=state.value)
            case _:
                assert_never(event)
        await self._connection.execute(statement)

    async def _changes(self, condition: sa.ColumnElement[bool]) -> list[Change]:
        c, w = t.changes.c, t.change_words.c
        ordered = sa.select(t.changes).where(condition).order_by(c.proposed_ms, c.change_id)
        found = (await self._connection.execute(ordered)).all()
        if not found:
            return []
        said: dict[tuple[str, str], set[str]] = defaultdict(set)
        words = sa.select(w.change_id, w.person, w.word).where(
            w.change_id.in_(sa.select(t.changes.c.change_id).where(condition))
        )
        for change_id, person, word in await self._connection.execute(words):
            said[change_id, word].add(person)
        return [
            Change(
                change_id=row.change_id,
                kind=ChangeKind.ROLES if (row.kind, row.key) == (ChangeKind.PERSON, None) else ChangeKind(row.kind),
                person=row.person,
                by=row.proposed_by,
                proposed_ms=row.proposed_ms,
                name=row.name,
                roles=frozenset(map(PersonRole, row.roles)),
                key=None if row.key is None else bytes(row.key),
                credential=row.credential or "",
                reason=row.reason,
                end=None if row.ended is None else ChangeState(row.ended),
                confirmed=frozenset(said[row.change_id, Word.CONFIRM.value]),
                declined=frozenset(said[row.change_id, Word.DECLINE.value]),
                login=row.login,
                by_passkey=row.by_passkey,
            )
            for row in found
        ]
