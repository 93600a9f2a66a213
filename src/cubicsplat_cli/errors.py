"""Errors that reach the user as one line, each with the exit code of the command line contract."""

from __future__ import annotations


class CubicSplatError(Exception):
    """Base of every error this package raises on purpose: its text says what is wrong and what to do."""

    exit_code = 1


class InputError(CubicSplatError):
    """A file, a picture or a scene that cannot be used as it is."""


class EngineError(CubicSplatError):
    """The rendering engine is missing, failed its self-test, or met a non-finite value."""


class UsageError(CubicSplatError):
    """An option has a value that makes no sense; reported like a command line mistake."""

    exit_code = 2
