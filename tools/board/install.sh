#!/bin/sh
# Install edge-vpr on Raspberry Pi OS, Debian or Ubuntu, as a service. Run again to update.
set -eu

usage() {
    cat <<'TEXT'
usage: sudo sh install.sh [--root DIR] [--source REQUIREMENT] [--back | --uninstall]

  --root DIR            install into the system whose root is DIR (an SD card, say); runs programs
                        of that system as root, by chroot
  --source REQUIREMENT  what pip installs: a folder or a requirement (default: this checkout)
  --back                return to the version before the last update
  --uninstall           remove all of it but the maps in /var/lib/edge-vpr and /etc/default/edge-vpr

Installs: /opt/edge-vpr/a or /opt/edge-vpr/b (Python environments of the running version and the one
before; /opt/edge-vpr/current is the running one), the system user edge-vpr without a home,
/var/lib/edge-vpr (maps), /var/cache/edge-vpr (compiled kernels), /etc/default/edge-vpr (arguments),
/etc/systemd/system/edge-vpr.service.
TEXT
}

fail() {
    echo "error: $1" >&2
    exit 1
}

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
needed_mib=1000
wants=etc/systemd/system/multi-user.target.wants
root=
source=
staged=
task=install_all
while [ $# -gt 0 ]; do
    case $1 in
        --root | --source)
            [ $# -ge 2 ] || fail "$1 needs a value: see --help"
            [ "$1" = --root ] && root=${2%/} || source=$2
            shift
            ;;
        --back) task=go_back ;;
        --uninstall) task=uninstall ;;
        -h | --help)
            usage
            exit 0
            ;;
        *) fail "unknown argument $1: see --help" ;;
    esac
    shift
done
[ "$(id -u)" = 0 ] || fail "this changes the system: run it with sudo"
[ -z "$root" ] || [ -d "$root" ] || fail "$root is not a folder: name the root of a system"

# Run a command in the system that is installed into.
inside() {
    if [ -n "$root" ]; then chroot "$root" "$@"; else "$@"; fi
}

# Refuse a card with links where this script writes: absolute ones lead into this machine.
check_links() {
    [ -n "$root" ] || return 0
    for path in opt/edge-vpr var/cache/edge-vpr var/lib/edge-vpr var/tmp tmp etc/default/edge-vpr \
        etc/systemd/system/edge-vpr.service "$wants/edge-vpr.service" \
        etc/udev/rules.d/90-edge-vpr.rules; do
        # our own link
        [ "$path" != "$wants/edge-vpr.service" ] || path=$wants
        while [ "$path" != . ]; do
            [ ! -L "$root/$path" ] ||
                fail "$root/$path is a link, which may lead out of $root: put a folder or file there"
            path=$(dirname -- "$path")
        done
    done
}

# Tell systemd of new files, if it runs and they are those of this system.
reload() {
    [ -z "$root" ] && [ -d /run/systemd/system ] || return 0
    systemctl daemon-reload
    systemctl try-restart edge-vpr.service
}

uninstall() {
    if [ -z "$root" ] && [ -d /run/systemd/system ]; then
        systemctl stop edge-vpr.service 2>/dev/null || true
    fi
    rm -f "$root/$wants/edge-vpr.service" \
        "$root/etc/systemd/system/edge-vpr.service" "$root/etc/udev/rules.d/90-edge-vpr.rules"
    rmdir "$root/$wants" 2>/dev/null || true
    rm -rf "$root/opt/edge-vpr" "$root/var/cache/edge-vpr"
    if inside id edge-vpr >/dev/null 2>&1; then
        # the number of the user is free afterwards: the next user would own what is left
        inside find / /var /tmp /var/tmp -xdev \( -user edge-vpr -o -group edge-vpr \) \
            -exec chown -h root:root '{}' +
        inside userdel edge-vpr
    fi
    reload
    echo "edge-vpr is removed; maps in $root/var/lib/edge-vpr and $root/etc/default/edge-vpr stay"
}

# Refuse a first installation that would fill the card; try_install.sh measures what one takes.
check_space() {
    [ ! -x "$root/opt/edge-vpr/$slot/bin/edge-vpr" ] || return 0
    for folder in opt var/tmp; do
        free=$(df -Pk "$root/$folder" | awk 'NR == 2 { print int($4 / 1024) }')
        [ "$free" -ge $needed_mib ] ||
            fail "$root/$folder has $free MiB free, and $needed_mib are needed: make room first"
    done
}

# Run pip, whose wheels need not fit into a /tmp in memory; what it says stands above the error.
run_pip() {
    inside env TMPDIR=/var/tmp "/opt/edge-vpr/$slot/bin/python" -m pip install --quiet \
        --no-cache-dir --disable-pip-version-check "$@" ||
        fail "pip could not install edge-vpr: mend what it says (a network? a full card?), and run this again"
}

# Take a checkout where a chroot sees it, and no other user can change it meanwhile.
bring_source() {
    staged=$(mktemp -d "$root/tmp/edge-vpr.XXXXXX")
    trap 'rm -rf "$staged"' EXIT
    cp "$here/requirements.txt" "$staged"
    case ${source:-$here/../..} in
        /* | .*) folder=${source:-$here/../..} ;;
        *) return 0 ;;
    esac
    [ -f "$folder/pyproject.toml" ] || fail "$folder is no checkout: name one with --source"
    for part in pyproject.toml README.md LICENSE edge_vpr firmware_model fixedpoint; do
        cp -R "$folder/$part" "$staged/$part"
    done
    mkdir "$staged/tools"
    cp -R "$folder/tools/edge_vpr_tools" "$staged/tools"
    source=${staged#"$root"}
}

# Print the name of the version that is not running.
other_slot() {
    if [ "$(readlink "$root/opt/edge-vpr/current" 2>/dev/null)" = a ]; then echo b; else echo a; fi
}

# Make a version the running one, in one step.
switch_to() {
    ln -sfn "$1" "$root/opt/edge-vpr/next"
    mv -T "$root/opt/edge-vpr/next" "$root/opt/edge-vpr/current"
}

go_back() {
    slot=$(other_slot)
    [ -x "$root/opt/edge-vpr/$slot/bin/edge-vpr" ] || fail "there is no version to go back to"
    switch_to "$slot"
    reload
    echo "the version before the last update is running again; --back once more undoes this"
}

install_all() {
    slot=$(other_slot)
    inside python3 -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
        fail "Python 3.11 or newer with venv is needed: apt install python3-venv"
    check_space
    bring_source
    if ! inside id edge-vpr >/dev/null 2>&1; then
        inside useradd --system --user-group --no-create-home --home-dir /nonexistent \
            --shell /usr/sbin/nologin edge-vpr
    fi
    inside install -d -o edge-vpr -g edge-vpr -m 755 /var/lib/edge-vpr /var/cache/edge-vpr
    # beside the running version, which an error or a power cut leaves as it is
    rm -rf "$root/opt/edge-vpr/$slot"
    mkdir -p "$root/opt/edge-vpr"
    inside python3 -m venv "/opt/edge-vpr/$slot"
    # with what builds edge-vpr: nothing is taken from an index but files of known content
    run_pip --require-hashes --only-binary :all: -r "${staged#"$root"}/requirements.txt"
    run_pip --no-deps --no-build-isolation "$source"
    # before doctor, which would say that extras are installed from there
    rm -rf "$staged"
    [ -e "$root/etc/default/edge-vpr" ] ||
        install -D -m 644 "$here/edge-vpr.conf" "$root/etc/default/edge-vpr"
    install -D -m 644 "$here/edge-vpr.service" "$root/etc/systemd/system/edge-vpr.service"
    # of an earlier installer, which claimed every bridge of FTDI
    rm -f "$root/etc/udev/rules.d/90-edge-vpr.rules"
    mkdir -p "$root/$wants"
    ln -sf ../edge-vpr.service "$root/$wants/edge-vpr.service"
    inside runuser -u edge-vpr -- env -i PATH=/usr/bin:/bin NUMBA_CACHE_DIR=/var/cache/edge-vpr \
        MPLCONFIGDIR=/var/cache/edge-vpr/matplotlib "/opt/edge-vpr/$slot/bin/edge-vpr" \
        doctor || echo "warning: edge-vpr doctor failed" >&2
    switch_to "$slot"
    # of installers before there were two versions
    for part in bin include lib lib64 share pyvenv.cfg; do rm -rf "$root/opt/edge-vpr/$part"; done
    reload
    cat <<TEXT
edge-vpr is installed. Copy a map to $root/var/lib/edge-vpr/map.npz, put the camera's port and
arguments into $root/etc/default/edge-vpr, and start it: systemctl start edge-vpr. Matches:
journalctl -u edge-vpr -f
TEXT
}

check_links
$task
