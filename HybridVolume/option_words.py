# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How the words of the command line are read; what is wrong with one is a line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from HybridVolume.errors import InputError
from HybridVolume.job import MESH_EXPORTS, SHELL_EXPORTS, SURFACE_EXPORTS

GEOMETRY_SUFFIXES = (".step", ".stp", ".brep", ".brp")


def share(text: str) -> float:
    """A number between 0 and 1."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number between 0 and 1")
    return value


def count(text: str) -> int:
    """A count of 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no count of 1 or more")
    return int(text)


def steps(text: str) -> int:
    """A number of subdivisions."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no number of subdivisions")
    return int(text)


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no number")
    return value


def samples(text: str) -> int:
    """A number of samples."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no number of samples")
    return int(text)


def midstructure(text: str) -> str:
    """A method that needs nothing else, or a file."""
    if Path(text).suffix.lower() in GEOMETRY_SUFFIXES:
        return text
    from HybridVolume.core.midstructure.search import METHODS

    methods = [method for method in METHODS if method != "own"]
    if text not in methods:
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(methods)}, and no STEP or BREP file"
        )
    return text


def depth(text: str) -> str:
    """A share or a length, as of the midstructure ``distance``."""
    from HybridVolume.core.midstructure.search import parse_depth

    parsed(parse_depth, text)
    return text


def thickness(text: str) -> str:
    """A thickness of the shell."""
    from HybridVolume.core.goals import Thickness

    return parsed(Thickness.parse, text).text


def spacing(text: str) -> str:
    """Heights of its layers."""
    from HybridVolume.core.levels import Spacing

    return parsed(Spacing.parse, text).text


def factor(text: str) -> str:
    """A factor of a face."""
    from HybridVolume.core.goals import parse_factor

    parsed(parse_factor, text)
    return text


def density(name: str, kind: type = float) -> Callable[[str], Any]:
    """Reads a number that `Density` takes under this name."""

    def read(text: str) -> Any:
        from HybridVolume.core.density import Density

        value = int(text) if kind is int and text.isdecimal() else number(text)
        if kind is int and not isinstance(value, int):
            raise argparse.ArgumentTypeError(f"{text!r} is no count")
        parsed(lambda _: Density(**{name: value}), text)
        return value

    return read


def evenness(name: str) -> Callable[[str], float]:
    """Reads a number that `Evenness` takes under this name."""

    def read(text: str) -> float:
        from HybridVolume.core.even import Evenness

        value = number(text.strip().removesuffix("mm") if name == "size" else text)
        parsed(lambda _: Evenness(**{name: value}), text)
        return value

    return read


def length(text: str) -> float:
    """A length above 0 mm."""
    value = density("size")(text.strip().removesuffix("mm"))
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is no length above 0 mm")
    return value


def face_size(text: str) -> str:
    """A size at a face."""
    from HybridVolume.core.density import parse_size

    parsed(parse_size, text)
    return text


def formats(text: str) -> list[str]:
    """Names of formats, with commas."""
    names = [name.strip().lower() for name in text.split(",")]
    known = (*MESH_EXPORTS, *SURFACE_EXPORTS, *SHELL_EXPORTS)
    for name in names:
        if name not in known:
            raise argparse.ArgumentTypeError(
                f"{name!r} is no format; choose some of {', '.join(known)}"
            )
    return names


def parsed(parse: Callable[[str], Any], text: str) -> Any:
    """Parse a word of the command line; what is wrong with it is one line."""
    try:
        return parse(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(error.line) from None


class Decide(argparse.Action):
    """Collects decisions about sheets of all kinds in their order."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: Any = None
    ) -> None:
        from HybridVolume.core.midstructure import Decision

        try:
            decision = Decision.about(self.const, values)
        except InputError as error:
            raise argparse.ArgumentError(self, error.line) from None
        namespace.decisions = [*namespace.decisions, str(decision)]
