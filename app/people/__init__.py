"""Authentication and authorization: tokens, browser sessions, roles, and the middleware before every route."""
