"""Entry point of the program. Each worker process imports it again, so it imports nothing itself."""


def main() -> None:
    """Run the command line, with an orderly end on signals and at limits of the machine."""
    import gc

    from app.host.process_end import exit_on_signals
    from app.host.system_errors import report_system_errors

    exit_on_signals()
    try:
        with report_system_errors():
            from app.cli.main import main as run

            run()
    finally:
        gc.freeze()  # otherwise the interpreter takes half a second to collect all modules before it ends
