# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line's way to the paper's method, as far as the options."""

import pytest

from HybridVolume.completion import parameters_of
from HybridVolume.core.pipeline import Options
from HybridVolume.errors import InputError, SetupError
from HybridVolume.options import parser

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from HybridVolume.objects.volume import options_of


def options(*words):
    return Options(**options_of(parameters_of(parser().parse_args(["body.step", *words]))))


def test_the_method_arrives():
    assert options().method == "certified"
    chosen = options("--method", "paper", "--w0", "0.3", "--layers", "3")
    assert (chosen.method, chosen.w0, chosen.layers) == ("paper", 0.3, 3)


@pytest.mark.parametrize(
    "words",
    [("--thickness", "2 mm"), ("--face-factor", "Face3=1.5"), ("--spacing", "distance")],
)
def test_what_the_method_cannot_do_is_refused_before_any_work(words):
    assert options(*words).method == "certified"
    with pytest.raises(InputError) as caught:
        options(*words, "--method", "paper")
    assert "paper" in caught.value.message and "--method certified" in caught.value.remedy


def test_no_other_method_is_known(capsys):
    with pytest.raises(SystemExit) as caught:
        parser().parse_args(["body.step", "--method", "magic"])
    assert caught.value.code == 2 and "magic" in capsys.readouterr().err
