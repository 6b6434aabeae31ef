"""`deepfsi` and `python -m deepfsi`."""

from typing import NoReturn

from deepfsi.base import interrupts


def main() -> NoReturn:
    """Run the command line, with Ctrl-C handled from the first moment."""
    interrupts.arm()
    from deepfsi import cli

    try:
        cli.main()
    except KeyboardInterrupt:  # before the command's own handler
        interrupts.leave()
    except SystemExit as end:
        if end.code == interrupts.STOPPED:
            interrupts.leave()
        raise


if __name__ == "__main__":
    main()
