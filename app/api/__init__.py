"""What browsers and programs ask: the application and its routes."""
