"""The HTTP and WebSocket interface: the application and its routes."""
