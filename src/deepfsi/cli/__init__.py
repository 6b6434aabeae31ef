"""The command line: settings in, a result out, said in lines or as JSON."""

from deepfsi.cli.app import app, main

__all__ = ["app", "main"]
