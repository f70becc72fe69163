"""Questions pushed to where people look: messages, the webhooks that take them, and when each is sent."""
