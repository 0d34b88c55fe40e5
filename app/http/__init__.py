"""HTTP: connections, request origins, rate limits, the audit of requests, and error responses."""
