"""The command line: settings in, a result out, said in lines or as JSON."""

from deepfsi.cli.app import app, run_command_line

__all__ = ["app", "run_command_line"]
