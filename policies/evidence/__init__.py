"""The request and the evidence that a decision is made from, and their plain JSON form."""
