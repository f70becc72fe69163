"""The identity provider as pure functions: `(state, command, at) -> events | refusal`.

No framework, store, socket or clock.
"""
