"""Errors that reach the user as one line, each with the exit code of the command line contract."""

from __future__ import annotations

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130


class CubicSplatError(Exception):
    """The base of all errors that this package raises on purpose; the text names the problem and a remedy."""

    exit_code = EXIT_FAILED


class InputError(CubicSplatError):
    """A file, a picture or a scene cannot be used as it is."""


class EngineError(CubicSplatError):
    """The rendering engine is missing, fails its self-test, or meets a non-finite value."""


class DeviceError(EngineError):
    """A GPU fails, is gone, or has no memory left; the CPU could go on."""


class UsageError(CubicSplatError):
    """A value makes no sense; the command reports it as a mistake on the command line.

    setting: the name in Python ("time_limit") of the setting with the value, or None. The text continues after the name
    ("must be ...").
    """

    exit_code = EXIT_USAGE

    def __init__(self, text: str, setting: str | None = None) -> None:
        super().__init__(text, setting)
        self.text = text
        self.setting = setting

    def __str__(self) -> str:
        return self.text if self.setting is None else f"{self.setting} {self.text}"

    def as_option(self) -> str:
        """Return the text with the name of the option ("--time-limit must be ...")."""
        return self.text if self.setting is None else f"--{self.setting.replace('_', '-')} {self.text}"
