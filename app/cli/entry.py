"""Where the program begins. Its workers, being processes of their own, import this again: so it is nearly nothing."""


def main() -> None:
    """The command line."""
    from app.cli.main import main as run

    run()
