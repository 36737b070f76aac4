#!/bin/busybox sh
# First program of the guest: the host's files read-only, what is written to them in memory, then /run/guest/start.
busybox=/bin/busybox
$busybox mount -t devtmpfs none /dev
$busybox mount -t proc none /proc
$busybox mount -t sysfs none /sys
for module in $($busybox cat /modules/order); do
    $busybox insmod "/modules/$module" || echo "guest: no module $module"
done
# cache=loose: nobody else writes while the guest reads, and Python looks at thousands of files.
$busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=524288 host /lower || $busybox poweroff -f
$busybox mount -t tmpfs none /upper
$busybox mkdir /upper/data /upper/work
lower=/lower
[ -b /dev/vda ] && $busybox mount -t ext4 -o ro /dev/vda /disk && lower=/disk:/lower
$busybox mount -t overlay -o lowerdir=$lower,upperdir=/upper/data,workdir=/upper/work none /new || $busybox poweroff -f
for place in dev proc sys; do
    $busybox mount --move /$place /new/$place
done
$busybox mount -t tmpfs none /new/run
$busybox mkdir -p /new/run/guest /new/dev/shm /new/dev/pts
$busybox mount -t tmpfs none /new/dev/shm
$busybox mount -t devpts none /new/dev/pts
$busybox mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 share /new/run/guest || $busybox poweroff -f
exec $busybox switch_root -c /dev/console /new /bin/sh -c '
    /bin/bash /run/guest/start
    echo $? > /run/guest/status
    sync
    exec /bin/busybox poweroff -f'
