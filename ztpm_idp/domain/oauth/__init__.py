"""OAuth in the domain: clients, scope templates, assents of people, and the access tokens that follow."""
