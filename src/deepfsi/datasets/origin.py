"""Sources of data sets, so that a design can load its own again."""

from pydantic import BaseModel, ConfigDict


class Origin(BaseModel):
    """Name or path of a data set, and the options it was loaded with."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str  # name, or absolute path
    # As in `load_dataset`; white is the one in force, where the type of the values has none
    size: tuple[int, int] | None = None
    seed: int = 0
    rescale: tuple[float, float] | None = None
    images: int | None = None
    split: str | None = None
    white: float | None = None
    # Absolute path of the calibration folder of the camera that sees the scenes
    view: str | None = None

    @property
    def words(self) -> str:
        """Name or path, with size and camera."""
        size = f" at {self.size[0]}x{self.size[1]}" if self.size else ""
        view = f" as the camera of {self.view} sees it" if self.view else ""
        return f"{self.data}{size}{view}"
