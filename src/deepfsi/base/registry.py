"""Parts that packages beside the core provide, found by their entry points of group ``deepfsi``."""

from functools import cache
from typing import Any

from deepfsi.base.errors import as_input_error, check_choice
from deepfsi.base.plugins import load_plugin


class Registry:
    """Parts by their names, each with its import path: it is loaded when it is used."""

    def __init__(self) -> None:
        # Import paths by kind and name. A projector shows passes of all frames, a list projector
        # frames that are chosen meanwhile; adaptive masks go by the noise of their detectors
        self.parts: dict[str, dict[str, str]] = {
            "projector": {},  # a `PassProjector`
            "list projector": {},  # a `StreamingProjector`
            "counter": {},  # a `StreamingCounter`
            "classifier": {},  # its `ClassifierFacts`
            "adaptive": {},  # its `AdaptiveTraining`
        }
        # By the kind of their entries: the settings that ask for an exposure, and its class
        self.schemes: dict[str, tuple[tuple[str, ...], str]] = {}
        # By their words, such as "camera transits": import path and summary
        self.commands: dict[str, tuple[str, str]] = {}

    def add_scheme(self, kind: str, settings: tuple[str, ...], target: str) -> None:
        """Add a kind of exposure: the settings that ask for it, and their class, an `Exposure`."""
        self.schemes[kind] = settings, target

    def add_part(self, kind: str, name: str, target: str) -> None:
        """Add a part; of a device a class or function whose keywords are its settings."""
        self.parts[kind][name] = target

    def add_command(self, words: str, target: str, summary: str) -> None:
        """Add a command of `deepfsi`, or of one of its groups: a `Command`."""
        self.commands[words] = target, summary

    def open_device(self, role: str, text: str, **wiring: Any) -> Any:
        """Driver of a device by ``NAME[,SETTING=VALUE...]``, not yet taken hold of."""
        name, *settings = text.split(",")
        check_choice(role, name, self.parts[role])
        with as_input_error():
            return load_plugin(self.parts[role][name])(
                **wiring, **dict(setting.partition("=")[::2] for setting in settings)
            )


@cache
def installed() -> Registry:
    """Parts of all packages that are installed; one that was removed is left out."""
    from importlib.metadata import entry_points
    from importlib.util import find_spec

    registry = Registry()
    for point in entry_points(group="deepfsi"):
        if find_spec(point.module.partition(".")[0]):
            point.load()(registry)
    return registry
