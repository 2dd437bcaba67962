#!/usr/bin/env bash
# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
# ./test.sh [RUN ...]: every check and test, or the named runs only (see scripts/run_tests.py).
# Installs what is missing first, as run.sh does, and what the tests need besides.
set -euo pipefail

project=$(cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")" && pwd -P)
# shellcheck source=scripts/setup.sh
source "$project/scripts/setup.sh"

need_packages "${packages_run[@]}" "${packages_test[@]}"
need_newer_packages
need_environment --development
exec 9>&-
exec /usr/bin/python3 "$project/scripts/run_tests.py" "$@"
