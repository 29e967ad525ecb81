#!/bin/sh
# Run the tests in a Debian made here, of another processor or Python.
# No root is needed: all mounts are those of a namespace, and end with it however it ends.
set -eu

usage() {
    cat <<'TEXT'
usage: [VARIABLE=VALUE ...] sh tests/in_debian.sh {amd64|arm64} {3.11|3.13|3.14} [PYTEST ARGUMENT ...]

  PART=kernels    the kernels of distances (the default); whole: all but the slow tests,
                  commands, pages, packages, gateware, and firmware, which has a processor of its own
  CPU=cortex-a72  of arm64 on another processor, as qemu calls it: a Raspberry Pi 4's (5: cortex-a76)
  CACHE=.debian   where the system is kept, with compiled kernels; remove it to begin again

Arguments for pytest replace the part.
TEXT
}

fail() {
    echo "error: $1" >&2
    exit 1
}

kernels="distances matches"
elsewhere="board documents evpr_firmware examples firmware hardware in_debian packages publishing
    report_pages rooms security site sweep"
# these start many processes, and qemu translates each anew
commands="command_line commands doctor estimate event_lab every_flag power recordings_commands rivals
    runs simulate_command"

case ${1:-} in
    amd64) machine=x86_64 ;;
    arm64) machine=aarch64 ;;
    -h | --help)
        usage
        exit 0
        ;;
    *) fail "the processor is ${1:-missing}, which is neither amd64 nor arm64: see --help" ;;
esac
case ${2:-} in
    3.11) suite=bookworm ;;
    3.13) suite=trixie ;;
    3.14) suite=forky ;;
    *) fail "no Debian has Python ${2:-of no version}: 3.11, 3.13 and 3.14 can be had" ;;
esac
architecture=$1 version=$2 cpu=${CPU:-cortex-a72} part=${PART:-kernels}
shift 2
case $part in kernels | whole) ;; *) fail "PART=$part is neither kernels nor whole" ;; esac

here=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
cache=${CACHE:-$here/.debian}
binfmt=/proc/sys/fs/binfmt_misc

# Run a shell in namespaces of its own, where it is root and may mount.
apart() {
    unshare --user --map-root-user --mount --pid --fork --kill-child sh -euc "$@"
}

bootstrap=$(PATH=$PATH:/usr/sbin command -v debootstrap) || fail "no debootstrap: apt install debootstrap"
apart true 2>/dev/null || fail "this user may not make namespaces: run it as root"
qemu=
if [ "$machine" != "$(uname -m)" ] && [ ! -e "$binfmt/qemu-$machine" ]; then
    [ $machine = aarch64 ] || fail "$machine is emulated on no other processor"
    qemu=$(command -v qemu-aarch64-static) || fail "no qemu-aarch64-static: apt install qemu-user-static"
    apart "mount -t binfmt_misc binfmt_misc $binfmt" 2>/dev/null ||
        fail "qemu-aarch64 is not registered: apt install binfmt-support, or use Linux 6.7 or newer"
fi
mkdir -p "$cache"
cache=$(CDPATH='' cd -- "$cache" && pwd -P)
root=$cache/$architecture-$version

# Packages are unpacked, not configured: Python needs no more, and qemu would take minutes.
make_root() {
    rm -rf "$root.part"
    unshare --map-root-user "$bootstrap" --download-only --arch="$architecture" --variant=minbase \
        --include="python$version,python$version-venv" "$suite" "$root.part" \
        http://deb.debian.org/debian /usr/share/debootstrap/scripts/sid >"$root.log" 2>&1 ||
        fail "debootstrap failed: see $root.log"
    for package in "$root.part"/var/cache/apt/archives/*.deb; do
        dpkg-deb -x "$package" "$root.part"
        rm "$package"
    done
    for file in passwd group; do
        cp "$root.part/usr/share/base-passwd/$file.master" "$root.part/etc/$file"
    done
    echo '127.0.0.1 localhost' >"$root.part/etc/hosts"
    mv "$root.part" "$root"
}

# Run a command in that system, and in this checkout, which has the same path there.
inside() {
    # shellcheck disable=SC2016 # expanded by the shell in there
    apart '
        root=$1 here=$2 binfmt=$3 qemu=$4 cpu=$5
        shift 5
        if [ -n "$qemu" ]; then
            mount -t binfmt_misc binfmt_misc "$binfmt"
            zeros="\\x00\\x00\\x00\\x00\\x00\\x00\\x00\\x00"
            ones="\\xff\\xff\\xff\\xff\\xff\\xff\\xff"
            # 64-bit little-endian ELF of machine 183, an executable or a shared object
            printf "%s" ":qemu-aarch64:M::\\x7fELF\\x02\\x01\\x01\\x00$zeros\\x02\\x00\\xb7\\x00" \
                ":$ones\\x00$ones\\xff\\xfe\\xff\\xff\\xff:$qemu:F" >"$binfmt/register"
        fi
        mkdir -p "$root$here"
        mount --rbind /dev "$root/dev"
        mount -t proc proc "$root/proc"
        mount --bind "$here" "$root$here"
        exec chroot "$root" /usr/bin/env -i QEMU_CPU="$cpu" HOME=/root LANG=C.UTF-8 \
            PATH=/opt/edge-vpr/bin:/usr/bin:/bin PYTHONPYCACHEPREFIX=/root/pycache \
            NUMBA_CACHE_DIR=/root/numba /bin/sh -euc "cd \"\$0\"; exec \"\$@\"" "$here" "$@"
    ' sh "$root" "$here" $binfmt "$qemu" "$cpu" "$@"
}

# Wheels are chosen and unpacked by this machine's uv: by qemu it takes a quarter of an hour.
install_packages() {
    uv=$cache/uv/bin/uv
    if [ ! -x "$uv" ]; then
        rm -rf "$cache/uv"
        "${PYTHON:-python3}" -m venv "$cache/uv"
        "$cache/uv/bin/pip" install --quiet uv || fail "no uv from PyPI: is there a network?"
    fi
    rm -rf "$root/opt/edge-vpr"
    inside "/usr/bin/python$version" -m venv --without-pip /opt/edge-vpr
    # what has no wheel for each of these Pythons and processors, and would need a compiler
    printf '%s; python_version < "3"\n' tonic >"$root/opt/edge-vpr/left-out.txt"
    set -- --quiet --target "$root/opt/edge-vpr/lib/python$version/site-packages" \
        --python-version "$version" --python-platform $machine-unknown-linux-gnu
    "$uv" pip install "$@" --only-binary :all: --requirements "$here/pyproject.toml" --extra test \
        --overrides "$root/opt/edge-vpr/left-out.txt"
    "$uv" pip install "$@" --no-deps --editable "$here"
    cp "$here/pyproject.toml" "$root/opt/edge-vpr/installed.toml"
}

[ -d "$root" ] || make_root
cmp -s "$here/pyproject.toml" "$root/opt/edge-vpr/installed.toml" || install_packages

if [ $# = 0 ]; then
    set -- -m "not slow"
    if [ "$part" = kernels ]; then
        for name in $kernels; do set -- "$@" tests/*/test_"$name".py; done
    else
        for name in $elsewhere $commands; do set -- "$@" "--ignore-glob=*/test_$name.py"; done
    fi
fi
inside python -c 'import platform, sys; print(platform.machine(), "Python", sys.version.split()[0])'
inside python -m pytest -q -p no:cacheprovider "$@"
