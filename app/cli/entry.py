"""Entry point of the program. Each worker process imports it again, so it imports nothing itself."""


def main() -> None:
    """Run the command line."""
    from app.cli.main import main as run

    run()
