"""Who may do what: tokens, browser sessions, roles, and the middleware that asks before every route."""
