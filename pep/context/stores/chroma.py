"""ChromaDB as a store of a collection, with an embedding that needs no model and no network.

The embedding is deterministic.

No answer of Chroma is believed here: `pep.context.retrieval` judges it. Without an embedding function Chroma would
download a model at the first use, so every way in states one.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import chromadb
import numpy as np
from chromadb.config import Settings
from chromadb.utils.embedding_functions import register_embedding_function

from pep.context.collection import StoredContent

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from chromadb.api import ClientAPI

DIMENSIONS: Final = 256
"""Dimensions that tell a few hundred short texts apart (ecosystem 5.4: tried)."""
NAME: Final = "ztpm-feature-hash"
_WORD: Final = re.compile(r"\w+")


@register_embedding_function
class FeatureHash(chromadb.EmbeddingFunction[chromadb.Documents]):
    """Embedding by hashing words and pairs of neighbours to signed places of a unit vector.

    The same text has the same vector.
    """

    def __init__(self, dimensions: int = DIMENSIONS) -> None:
        self._dimensions = dimensions

    def __call__(self, input: chromadb.Documents) -> chromadb.Embeddings:  # noqa: A002 - Chroma's word
        """One unit vector for each text."""
        return [self._vector(text) for text in input]

    def _vector(self, text: str) -> Any:
        vector = np.zeros(self._dimensions, dtype=np.float32)
        words = _WORD.findall(unicodedata.normalize("NFKC", text).casefold())
        for feature in (*words, *map(" ".join, pairwise(words))):
            place = int.from_bytes(hashlib.blake2b(feature.encode("utf-8", "replace"), digest_size=8).digest(), "big")
            vector[(place >> 1) % self._dimensions] += 1.0 if place & 1 else -1.0
        norm = float(np.linalg.norm(vector))
        if not norm > 0.0:  # nothing to tell it by: a place of its own, since the zero vector has no direction
            vector[0], norm = 1.0, 1.0
        return vector / norm

    @staticmethod
    def name() -> str:
        """Name of the embedding in a stored collection."""
        return NAME

    def get_config(self) -> dict[str, Any]:
        """Configuration that a stored collection keeps."""
        return {"dimensions": self._dimensions}

    @staticmethod
    def build_from_config(config: dict[str, Any]) -> FeatureHash:
        """Embedding function of a stored collection."""
        return FeatureHash(int(config["dimensions"]))


def client(path: Path | None) -> ClientAPI:
    """Chroma client inside this process, without telemetry: at `path`, or in memory when it is None."""
    settings = Settings(anonymized_telemetry=False, allow_reset=False)
    if path is None:
        return chromadb.EphemeralClient(settings=settings)
    return chromadb.PersistentClient(path=str(path), settings=settings)


class ChromaCollection:
    """The `Collection` port on one Chroma collection, made when it is missing.

    Args:
        chroma: the client.
        name: of the collection.
        embedding: by which texts are near each other.
    """

    def __init__(self, chroma: ClientAPI, name: str, *, embedding: chromadb.EmbeddingFunction[Any]) -> None:
        self._collection = chroma.get_or_create_collection(name, embedding_function=embedding)

    def nearest(self, query: str, *, most: int) -> Sequence[StoredContent]:
        """At most `most` contents, the nearest first, as Chroma returns them."""
        answer = self._collection.query(query_texts=[query], n_results=most, include=["documents"])
        documents = answer["documents"] or [[]]
        return [StoredContent(id_, text) for id_, text in zip(answer["ids"][0], documents[0], strict=True)]

    def ids(self, *, most: int) -> Sequence[str]:
        """At most `most` ids of the collection."""
        held: list[str] = self._collection.get(limit=most, include=[])["ids"]
        return held

    def keep(self, contents: Sequence[tuple[str, str]]) -> None:
        """Puts these (id, text) pairs into the collection, in place of earlier ones under their ids."""
        self._collection.upsert(ids=[id_ for id_, _ in contents], documents=[text for _, text in contents])
