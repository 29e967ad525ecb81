#!/bin/sh
# Install in a Debian root made from nothing, time the first match of a fresh process, and remove it.
set -eu

if [ $# -lt 3 ] || [ "$(id -u)" != 0 ]; then
    echo "usage: sudo sh try_install.sh ROOT MAP.npz BYTES.bin [SUITE]: ROOT is made if it is not there" >&2
    exit 2
fi
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
root=$1 map=$2 bytes=$3 suite=${4:-bookworm}

if [ ! -d "$root" ]; then
    debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates "$suite" "$root"
fi
# what pip of this machine is told, such as a certificate or an index nearer by
for file in /etc/pip.conf /etc/ssl/certs/ca-certificates.crt; do
    if [ -f "$file" ]; then cp "$file" "$root$file"; fi
done
mountpoint -q "$root/proc" || mount -t proc proc "$root/proc"
trap 'umount "$root/proc"' EXIT

sh "$here/install.sh" --root "$root"
needed=$(sed -n 's/^needed_mib=//p' "$here/install.sh")
taken=$(du -smc "$root/opt/edge-vpr" "$root/var/cache/edge-vpr" | awk 'END { print $1 }')
echo "installed: $taken MiB"
[ "$taken" -lt "$needed" ] || exit 1
echo 'STREAM="--baud 9600 --protocol evpr"' >"$root/etc/default/edge-vpr"
sh "$here/install.sh" --root "$root"
grep -q 9600 "$root/etc/default/edge-vpr" || exit 1
[ "$(readlink "$root/opt/edge-vpr/current")" = b ]
sh "$here/install.sh" --root "$root" --back
[ "$(readlink "$root/opt/edge-vpr/current")" = a ]

cp "$map" "$root/var/lib/edge-vpr/map.npz"
cp "$bytes" "$root/tmp/sent.bin"
chmod 644 "$root/var/lib/edge-vpr/map.npz" "$root/tmp/sent.bin"
for run in 1 2 3; do
    start=$(date +%s%N)
    # as edge-vpr.service does, but for the port
    chroot "$root" runuser -u edge-vpr -- env -i PATH=/usr/bin:/bin \
        NUMBA_CACHE_DIR=/var/cache/edge-vpr MPLCONFIGDIR=/var/cache/edge-vpr/matplotlib \
        /opt/edge-vpr/current/bin/edge-vpr stream --port /tmp/sent.bin --protocol evpr --once --json \
        --map /var/lib/edge-vpr/map.npz >"$root/tmp/matches.jsonl" &
    until grep -q '"match"' "$root/tmp/matches.jsonl" 2>/dev/null; do
        kill -0 $! 2>/dev/null || break
        sleep 0.02
    done
    end=$(date +%s%N)
    wait $!
    grep -q '"match"' "$root/tmp/matches.jsonl"
    echo "run $run: first match after $(((end - start) / 1000000)) ms"
    rm "$root/tmp/matches.jsonl"
done

sh "$here/install.sh" --root "$root" --uninstall
for left in opt/edge-vpr var/cache/edge-vpr etc/systemd/system/edge-vpr.service \
    etc/udev/rules.d/90-edge-vpr.rules; do
    if [ -e "$root/$left" ]; then
        echo "$left is left" >&2
        exit 1
    fi
done
[ -f "$root/var/lib/edge-vpr/map.npz" ]
if [ -n "$(find "$root" -xdev -nouser)" ]; then
    echo "files of the removed user are left" >&2
    exit 1
fi
if chroot "$root" id edge-vpr >/dev/null 2>&1; then
    echo "the user edge-vpr is left" >&2
    exit 1
fi
echo "installed twice, matched, and removed"
