#!/usr/bin/env bash
# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
# The proof of README's two commands: clones this checkout's last commit into a clean Debian with
# nothing but git, bash and apt, and runs both in it; then once more run.sh, without any network.
#
#   sudo scripts/chroot_check.sh SUITE FOLDER [--shared DIR] [-- COMMAND ...]
#
# SUITE is bookworm, trixie or a later one; FOLDER is made with debootstrap (about 3.5 GB in the end) and kept:
# called again, it renews the clone, and what was set up stays. --shared: a folder beside the clone
# for the tests that read shared data. COMMAND replaces the two commands, e.g. `-- ./test.sh gui`.
# MIRROR names another mirror. The host's certificates and its apt's Acquire settings are copied.
set -euo pipefail

suite=${1:?suite, e.g. bookworm} folder=${2:?folder of the chroot}
shift 2
shared=
commands=("./run.sh resources/examples/fandisk.step -o /root/result" "./test.sh")
while [ $# -gt 0 ]; do
    case $1 in
        --shared) shared=$(realpath -- "$2") && shift 2 ;;
        --) shift && commands=("$*") && set -- ;;
        *) echo "unknown argument $1" >&2 && exit 2 ;;
    esac
done
project=$(cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")/.." && pwd -P)
mirror=${MIRROR:-http://deb.debian.org/debian}

if [ ! -e "$folder/.made" ]; then
    # a suite younger than this debootstrap is made like sid
    recipe=/usr/share/debootstrap/scripts/$suite
    [ -e "$recipe" ] || recipe=/usr/share/debootstrap/scripts/sid
    debootstrap --variant=minbase "$suite" "$folder" "$mirror" "$recipe"
    touch "$folder/.made"
fi
folder=$(realpath -- "$folder")

# inside [--offline] COMMAND: runs a line of shell as root of the chroot, in namespaces of its own.
inside() {
    local network=()
    [ "$1" = --offline ] && network=(--net) && shift
    local kept=(HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
        TERM=dumb CI=true)
    local name
    for name in http_proxy https_proxy no_proxy PIP_CERT PIP_INDEX_URL PIP_DEFAULT_TIMEOUT \
        SSL_CERT_FILE; do
        [ -n "${!name:-}" ] && kept+=("$name=${!name}")
    done
    # shellcheck disable=SC2016
    unshare --mount --pid --fork --kill-child "${network[@]}" bash -c '
        mount --make-rprivate / && mount -t proc proc "$1/proc" && mount --rbind /dev "$1/dev" &&
            mount --rbind /sys "$1/sys" && mkdir -p "$1/mnt/project" &&
            mount --bind -o ro "$2" "$1/mnt/project" || exit 1
        if [ -n "$3" ]; then mkdir -p "$1/root/shared" && mount --bind -o ro "$3" "$1/root/shared"; fi
        shift 3
        exec "$@"' - "$folder" "$project" "$shared" \
        env -i "${kept[@]}" chroot "$folder" bash -c "$1" </dev/null
}

cp -L /etc/resolv.conf "$folder/etc/resolv.conf"
mkdir -p "$folder/usr/local/share/ca-certificates"
find /usr/local/share/ca-certificates -name '*.crt' \
    -exec cp {} "$folder/usr/local/share/ca-certificates/" \; 2>/dev/null || true
grep -ls '^Acquire::' /etc/apt/apt.conf.d/* | xargs -r cp -t "$folder/etc/apt/apt.conf.d/"
cat >"$folder/etc/apt/sources.list" <<SOURCES
deb $mirror $suite main
deb $mirror $suite-updates main
deb $mirror-security $suite-security main
SOURCES

if [ ! -d "$folder/root/project" ]; then
    inside "apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -q -y \
        --no-install-recommends git ca-certificates && update-ca-certificates &&
        git config --global --add safe.directory '*' &&
        git clone -q /mnt/project /root/project" >"$folder/root/preparation.log" 2>&1 ||
        { tail -n 20 "$folder/root/preparation.log" && exit 1; }
fi
inside "cd /root/project && git fetch -q origin && git reset -q --hard origin/HEAD && git log -1 --oneline"

failures=0
check() {
    local code=0 started=$SECONDS
    echo "--- ${*: -1}$([ "$1" = --offline ] && echo ' (no network)')"
    if [ "$1" = --offline ]; then
        inside --offline "cd /root/project && $2" || code=$?
    else
        inside "cd /root/project && $1" || code=$?
    fi
    echo "--- exit code $code after $((SECONDS - started)) s"
    [ "$code" -eq 0 ] || failures=$((failures + 1))
}
for command in "${commands[@]}"; do
    check "$command"
done
[ "${#commands[@]}" -eq 1 ] || check --offline "${commands[0]}"
[ "$failures" -eq 0 ]
