"""Base of the models of settings and of what files hold."""

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """Model that is never changed once it is made, and knows no other fields than its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")
