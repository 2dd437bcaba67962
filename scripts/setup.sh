# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
# The set-up that run.sh and test.sh share; sourced by them, with $project set.
# shellcheck shell=bash

say() { printf 'set-up: %s\n' "$*" >&2; }

# FreeCAD's side: FreeCAD with its Python, numpy and scipy, and a screen for pictures.
packages_run=(
    python3 python3-venv python3-numpy python3-scipy freecad freecad-python3 xvfb xauth
)
# Libraries that the wheels of gmsh, VTK and pytetwild load and do not bring.
packages_run+=(
    libgl1 libegl1 libglu1-mesa libgl1-mesa-dri libgomp1 libfontconfig1 libxcursor1 libxfixes3 libxft2
    libxinerama1 libxrender1
)
# What the tests need besides.
packages_test=(python3-pytest xdotool imagemagick)
# Taken where the distribution has them (Debian 13 has no CalculiX): only the solving needs it.
packages_optional=(calculix-ccx)

# Prints the names of those packages that are not installed, a line each.
absent_packages() {
    local installed
    installed=$(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "$@" 2>/dev/null |
        sed -n 's/^installed //p') || true
    printf '%s\n' "$@" | grep -vxF -e "$installed" || true
}

# Runs a command as root, its output in a log that is shown only when it fails.
as_root() {
    local log status=0
    log=$(mktemp)
    if [ "$(id -u)" -eq 0 ]; then
        env DEBIAN_FRONTEND=noninteractive "$@" </dev/null >"$log" 2>&1 || status=$?
    elif [ -t 0 ]; then
        sudo env DEBIAN_FRONTEND=noninteractive "$@" >"$log" 2>&1 || status=$?
    else
        sudo -n env DEBIAN_FRONTEND=noninteractive "$@" </dev/null >"$log" 2>&1 || status=$?
    fi
    if [ "$status" -ne 0 ]; then
        tail -n 15 "$log" >&2
    fi
    rm -f "$log"
    return "$status"
}

# Prints the names of those packages that the distribution offers, a line each.
offered_packages() {
    [ $# -gt 0 ] || return 0
    LC_ALL=C apt-cache policy "$@" 2>/dev/null |
        awk '/^[^ ]+:$/ { name = substr($1, 1, length($1) - 1) }
             /^  Candidate: / && $2 != "(none)" { print name }'
}

# Installs those of the named packages that are missing, and of the optional ones those that the
# distribution offers; ends the script when that cannot be done.
need_packages() {
    if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
        if [ -x /usr/bin/python3 ]; then
            return 0 # another distribution: what is missing says so itself
        fi
        say "this system has no apt; install FreeCAD, CalculiX, Xvfb and Python 3.11 or newer" \
            "with venv yourself, then run this again"
        exit 1
    fi
    local absent optional lock=(-o DPkg::Lock::Timeout=600)
    mapfile -t absent < <(absent_packages "$@")
    mapfile -t optional < <(absent_packages "${packages_optional[@]}")
    if [ "${#absent[@]}" -eq 0 ]; then
        # The package lists that are there tell what is offered, without any network.
        mapfile -t optional < <(offered_packages "${optional[@]}")
        { [ "${#optional[@]}" -gt 0 ] && may_install; } || return 0
    elif ! may_install; then
        say "packages are missing and this user may not install them; as root:" \
            "apt-get install --no-install-recommends ${absent[*]}"
        exit 1
    fi
    say "reading the distribution's package lists"
    as_root apt-get "${lock[@]}" update ||
        say "they could not be renewed; going on with those that are there"
    mapfile -t optional < <(offered_packages "${optional[@]}")
    absent+=("${optional[@]}")
    say "installing packages of the distribution: ${absent[*]}"
    say "(a first time, with all that they need, 600 MB and some minutes)"
    if [ -n "$(dpkg --audit 2>/dev/null)" ]; then
        say "finishing an installation that was interrupted"
        as_root dpkg --configure -a || true
    fi
    if ! as_root apt-get "${lock[@]}" install -y --no-install-recommends "${absent[@]}"; then
        mapfile -t absent < <(absent_packages "$@")
        if [ "${#absent[@]}" -eq 0 ]; then
            say "going on without ${optional[*]}"
            return 0
        fi
        say "the packages could not be installed; check the network, or run as root:" \
            "apt-get install --no-install-recommends ${absent[*]}"
        exit 1
    fi
}

# Installs what only newer versions of the packages need besides.
need_newer_packages() {
    local version
    version=$(dpkg-query -W -f='${Version}' freecad 2>/dev/null) || return 0
    # The FEM workbench of FreeCAD 1.1 imports VTK, which its package does not bring.
    if dpkg --compare-versions "$version" ge 1.1; then
        need_packages python3-vtk9
    fi
}

may_install() { [ "$(id -u)" -eq 0 ] || command -v sudo >/dev/null; }

# need_environment [--free-only] [--development]: makes the worker's environment where it is not
# there, and sets HYBRIDVOLUME_PYTHON to its interpreter. A value given by the caller is kept.
need_environment() {
    if [ -n "${HYBRIDVOLUME_PYTHON:-}" ]; then
        say "using HYBRIDVOLUME_PYTHON=$HYBRIDVOLUME_PYTHON as it is"
    else
        HYBRIDVOLUME_PYTHON=$(/usr/bin/python3 -P -m HybridVolume.environment "$@") || exit 1
    fi
    export HYBRIDVOLUME_PYTHON
}

# Two scripts started at once in one project folder set up one after the other.
if command -v flock >/dev/null && { exec 9>>"$project/.setup.lock"; } 2>/dev/null; then
    flock -n 9 || { say "waiting for another set-up that is under way" && flock 9; }
fi

# A user's own modules and settings must not get into FreeCAD's Python or the environment's.
unset PYTHONHOME
export PYTHONPATH=$project PYTHONNOUSERSITE=1
