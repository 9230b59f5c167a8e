"""Settings of a server, from ``SUBMAPS_*`` variables and from the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

PREFIX = "SUBMAPS_"


class Settings(BaseModel):
    """What a server is started with; each field can be set as ``SUBMAPS_<FIELD>``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = Field("127.0.0.1", description="address to listen on")
    port: int = Field(8080, ge=0, le=65535, description="port to listen on; 0 takes a free one")
    data_dir: Path = Field(Path("submaps-data"), description="directory that holds the journal")
    max_body_bytes: int = Field(16 * 2**20, ge=1024, description="largest request body, bytes")

    @classmethod
    def from_environment(cls, environment: Mapping[str, str], **given: object) -> Settings:
        """Return the settings of the environment, overridden by what is given and not None.

        Raises ``pydantic.ValidationError`` for a value that does not fit.
        """
        named: dict[str, object] = {
            name: environment[PREFIX + name.upper()]
            for name in cls.model_fields
            if PREFIX + name.upper() in environment
        }
        named |= {name: value for name, value in given.items() if value is not None}
        return cls.model_validate(named)
