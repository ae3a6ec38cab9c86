"""Where every command begins: ``swarmchase``, and ``python -m swarmchase``."""

from .processes.ctrl_c import end_silently


def main() -> None:
    """Run the command of the command line."""
    end_silently()
    from .cli import main as run

    run()


if __name__ == "__main__":
    main()
