"""AgentDojo, replayed: its attackers' calls are forced under scopes that are written from its user tasks."""
