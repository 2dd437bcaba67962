#!/usr/bin/env bash
# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
# ./run.sh BODY [options]: completes the volume of a body; `./run.sh --help` tells the options.
# Installs what is missing first. --free-only leaves the GPL parts out (cgal, gmsh).
set -euo pipefail

project=$(cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")" && pwd -P)
# shellcheck source=scripts/setup.sh
source "$project/scripts/setup.sh"

arguments=()
for argument in "$@"; do
    if [ "$argument" = --free-only ]; then
        export HYBRIDVOLUME_FREE_ONLY=1
    else
        arguments+=("$argument")
    fi
done

need_packages "${packages_run[@]}"
need_newer_packages
need_environment
exec 9>&- # the work itself may run side by side
# Many small matrices: threads would wait for each other. Workers set these themselves.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec /usr/bin/python3 -P -m HybridVolume "${arguments[@]}"
