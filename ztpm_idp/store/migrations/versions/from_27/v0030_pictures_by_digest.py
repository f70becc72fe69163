"""Pictures in a table of their own, by their digests."""

from __future__ import annotations

import hashlib
import zlib

import sqlalchemy as sa
from alembic import op

revision = "v0030"
down_revision = "v0029"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds the table, and moves the pictures of asks into it: each is named by its ask from then on."""
    pictures = op.create_table(
        "pictures",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("since_ms", sa.BigInteger(), nullable=False),
        sa.Column("bytes", sa.Integer(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_pictures")),
    )
    op.create_index("ix_pictures_since_ms", "pictures", ["since_ms", "digest", "bytes"], unique=False)
    op.add_column("asks", sa.Column("picture_digest", sa.String(length=64), server_default="", nullable=False))
    asks = sa.table("asks", *map(sa.column, ("ask_id", "picture", "picture_digest", "taken_ms")))
    store, moved = op.get_bind(), set[str]()
    ids = store.execute(sa.select(asks.c.ask_id).where(asks.c.picture != "").order_by(asks.c.taken_ms.desc()))
    for ask_id in list(ids.scalars()):  # one text in memory at a time
        query = sa.select(asks.c.picture, asks.c.taken_ms).where(asks.c.ask_id == ask_id)
        text, taken_ms = store.execute(query).one()
        raw = text.encode("ascii")
        digest = hashlib.sha256(raw).hexdigest()
        store.execute(sa.update(asks).where(asks.c.ask_id == ask_id).values(picture_digest=digest, picture=""))
        if digest not in moved:
            packed = zlib.compress(raw, 1)
            store.execute(
                sa.insert(pictures).values(digest=digest, since_ms=taken_ms, bytes=len(packed), packed=packed)
            )
            moved.add(digest)
    op.drop_column("asks", "picture")
