# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Document objects from tables of properties: one table serves the creation and the restoring."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import FreeCAD


@dataclass(frozen=True)
class Property:
    """A property of a document object.

    Attributes
    ----------
    type : str
        FreeCAD's type, e.g. ``"App::PropertyFloat"``.
    group : str
    doc : str
    default : object
        Value at creation; None leaves FreeCAD's. For an enumeration the first choice is taken.
    choices : tuple of str
        Of an enumeration.
    mode : tuple of {"ReadOnly", "Hidden"}
    """

    type: str
    group: str
    doc: str
    default: Any = None
    choices: tuple[str, ...] = ()
    mode: tuple[str, ...] = ()


_SCHEMA = Property(
    "App::PropertyInteger", "Base", "Version of the object's properties.", None, (), ("Hidden",)
)


class DocumentObject:
    """Base of the proxies. All data live in properties; a proxy has no state of its own."""

    Type: ClassVar[str]
    SCHEMA: ClassVar[int] = 1
    PROPERTIES: ClassVar[dict[str, Property]]

    def __init__(self, obj: Any) -> None:
        obj.Proxy = self
        self.ensure_properties(obj)
        self.prepare(obj)
        obj.SchemaVersion = self.SCHEMA
        attach_view(obj)

    def prepare(self, obj: Any) -> None:
        """Set what a new object must have before it is shown."""

    def ensure_properties(self, obj: Any) -> None:
        """Add what is absent from the object; leave the values that are there."""
        for name, row in {**self.PROPERTIES, "SchemaVersion": _SCHEMA}.items():
            if name not in obj.PropertiesList:
                obj.addProperty(row.type, name, row.group, row.doc)
                if row.choices:
                    setattr(obj, name, list(row.choices))
                if row.default is not None:
                    setattr(obj, name, row.default)
            elif row.choices and obj.getEnumerationsOfProperty(name) != list(row.choices):
                value = getattr(obj, name)
                setattr(obj, name, list(row.choices))
                if value in row.choices:
                    setattr(obj, name, value)
            obj.setEditorMode(name, list(row.mode))
            # What the program writes must not make the document ask for a recompute.
            obj.setPropertyStatus(name, "Output" if row.mode else "-Output")

    def onDocumentRestored(self, obj: Any) -> None:
        """Bring an object of an older file up to date."""
        if obj.Proxy is not self:
            obj.Proxy = self
        self.ensure_properties(obj)
        self.migrate(obj, obj.SchemaVersion)
        obj.SchemaVersion = self.SCHEMA
        attach_view(obj)

    def migrate(self, obj: Any, version: int) -> None:
        """Change values that an older version of the properties (``version``) stored."""

    def execute(self, obj: Any) -> None:
        """Do nothing at a recompute; the long work starts on demand."""

    # FreeCAD 0.20 asks for the first pair, later ones for the second.
    def __getstate__(self) -> None:
        return None

    def __setstate__(self, state: Any) -> None:
        return None

    def dumps(self) -> None:
        """Store nothing."""
        return None

    def loads(self, state: Any) -> None:
        """Restore nothing."""
        return None


def attach_view(obj: Any) -> None:
    """Give an object its view provider where FreeCAD has a window."""
    if FreeCAD.GuiUp and obj.ViewObject:
        # The one place where objects know of the window, as in FreeCAD's own ObjectsFem: documents
        # made without a window get their looks here when they are opened.
        from HybridVolume.gui import view_providers

        view_providers.attach(obj)


@contextlib.contextmanager
def transaction(doc: Any, name: str) -> Iterator[None]:
    """Make everything inside one step of Undo; a fault inside leaves the document as it was."""
    doc.openTransaction(name)
    try:
        yield
    except BaseException:
        doc.abortTransaction()
        raise
    doc.commitTransaction()


def include(obj: Any, name: str, path: str | os.PathLike) -> None:
    """Take a copy of a file into a property of a document object."""
    setattr(obj, name, (str(path), f"{obj.Name}_{name}.npz"))
