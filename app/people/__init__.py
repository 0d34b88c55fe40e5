"""Who may be here, and what each may do: tokens, sessions, the lease on the tool, and the gate before every route."""
