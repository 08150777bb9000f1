#!/usr/bin/env bash
# Several hosts on this machine, each with its own network, name, processes, /tmp and sshd; needs root.
#   hosts.sh FOLDER up N | in HOST COMMAND.. | part HOST | kill HOST | link HOST up|down | down
# The hosts nodeA, nodeB, .. share FOLDER and everything else outside of /tmp, /var/tmp and /dev/shm; one that is parted
# has an empty FOLDER of its own. Hosts of different FOLDERs know nothing of one another.
set -euo pipefail
folder=$(realpath "$1") && shift
state=$folder/.hosts
switch=$(basename "$folder")
names=(nodeA nodeB nodeC nodeD)
case $1 in
up)
  mkdir "$state" && cd "$state"
  ssh-keygen -q -t ed25519 -N '' -f key && ssh-keygen -q -t ed25519 -N '' -f hostkey && cp key.pub authorized
  echo 127.0.0.1 localhost >hosts
  for i in $(seq 0 $(($2 - 1))); do echo "10.77.0.$((i + 1)) ${names[i]}" >>hosts; done
  printf 'IdentityFile %s/key\nStrictHostKeyChecking no\nUserKnownHostsFile /dev/null\nLogLevel ERROR\n' "$state" >ssh_config
  ip netns add "$switch" && ip -n "$switch" link add br0 type bridge && ip -n "$switch" link set br0 up
  for i in $(seq 0 $(($2 - 1))); do
    host=${names[i]}
    cat >"start-$host" <<S
hostname $host; mount --make-rprivate /; mount --bind $state/hosts /etc/hosts; mkdir -p /run/sshd /mnt; ip link set lo up
mount --bind $folder /mnt; mount -t tmpfs tmpfs /tmp; chmod 1777 /tmp; mkdir -p $folder; mount --bind /mnt $folder; umount /mnt
mount -t tmpfs tmpfs /var/tmp; mount -t tmpfs tmpfs /dev/shm
exec /usr/sbin/sshd -D -e -f /dev/null -h $state/hostkey -o AuthorizedKeysFile=$state/authorized -o PermitRootLogin=yes -o StrictModes=no -o UsePAM=no -o PidFile=none -o MaxStartups=100 2>$state/sshd-$host.log
S
    setsid unshare --net --mount --uts --pid --ipc --fork --mount-proc --kill-child bash "start-$host" >"start-$host.log" 2>&1 &
    echo $! >"pid-$host"
    until pgrep -P "$(cat "pid-$host")" >"init-$host"; do sleep 0.1; done
    ip -n "$switch" link add "v$host" type veth peer name eth7 netns "$(cat "init-$host")"
    ip -n "$switch" link set "v$host" master br0 && ip -n "$switch" link set "v$host" up
    nsenter -t "$(cat "init-$host")" -n ip addr add "10.77.0.$((i + 1))/24" dev eth7
    nsenter -t "$(cat "init-$host")" -n ip link set eth7 up
  done ;;
in) host=$2 && shift 2 && exec nsenter -t "$(cat "$state/init-$host")" -n -m -u -p -i --wd="$folder" "$@" ;;
part)
  nsenter -t "$(cat "$state/init-$2")" -m sh -c 'cp -r "$0" /tmp/hosts && mount -t tmpfs tmpfs "$1" && mv /tmp/hosts "$0"' "$state" "$folder" ;;
kill) kill -9 "$(cat "$state/pid-$2")" ;;
link) ip -n "$switch" link set "v$2" "$3" ;;
down)
  for file in "$state"/pid-*; do kill -9 "$(cat "$file")" 2>/dev/null || true; done
  ip netns del "$switch" ;;
esac
