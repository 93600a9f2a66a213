"""Errors that reach the user as one line, each with the exit code of the command line contract."""

from __future__ import annotations


class CubicSplatError(Exception):
    """Base of every error this package raises on purpose: its text says what is wrong and what to do."""

    exit_code = 1


class InputError(CubicSplatError):
    """A file, a picture or a scene that cannot be used as it is."""


class EngineError(CubicSplatError):
    """The rendering engine is missing, failed its self-test, or met a non-finite value."""


class DeviceError(EngineError):
    """A GPU that fails at its work, is gone, or has no room; the CPU could go on."""


class UsageError(CubicSplatError):
    """A value that makes no sense; reported like a command line mistake.

    setting: the name of the setting that has it, as Python has it ("time_limit"), where it is one; the text then goes
    on after the name ("must be ...").
    """

    exit_code = 2

    def __init__(self, text: str, setting: str | None = None) -> None:
        super().__init__(text, setting)
        self.text = text
        self.setting = setting

    def __str__(self) -> str:
        return self.text if self.setting is None else f"{self.setting} {self.text}"

    def as_option(self) -> str:
        """The text with the setting named as the command line has it ("--time-limit must be ...")."""
        return self.text if self.setting is None else f"--{self.setting.replace('_', '-')} {self.text}"
