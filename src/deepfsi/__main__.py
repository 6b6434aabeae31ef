"""`deepfsi` and `python -m deepfsi`."""

import signal
import sys
import warnings
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line, with Ctrl-C handled from the first moment."""
    # Signals wait until their handler is there: within an import they do harm
    if sys.platform != "win32":
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    from deepfsi.base.interrupts import STOPPED_EXIT_CODE, end_process, install_handler

    install_handler()
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, usual)
    from deepfsi.cli import run_command_line

    # NumPy's warnings of numbers that are refused then; `sys.warnoptions` are for workers
    warnings.simplefilter("ignore", RuntimeWarning)
    sys.warnoptions.append("ignore::RuntimeWarning")
    try:
        run_command_line()
    except KeyboardInterrupt:  # before the command's own handler
        end_process()
    except SystemExit as end:
        if end.code == STOPPED_EXIT_CODE:
            end_process()
        raise


if __name__ == "__main__":
    main()
