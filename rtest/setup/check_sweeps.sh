#!/bin/sh
# check_sweeps.sh [NAME ...]: what machines do to sweeps.  Whatever happens, no point may be lost and none be there
# twice, and the table must be that of the session to the last bit.  The tests, all of them unless some are named:
#   workers   one worker on this machine, two and five, with chunks of other sizes; this machine in a list of hosts;
#             what has been declared, and initial values that depend on the grid
#   limits    a case of a map that does not stop at its limit of time
#   sessions  the session alone is interrupted (SIGINT), or killed in three ways: nothing of it goes on
#   kills     all workers are killed (SIGKILL) at random moments, 20 times
#   disk      the results fill a file system of 1 MB, which then grows
#   folder    the folder alone, moved elsewhere, by run_all
#   hosts     two hosts, network namespaces of this machine with a daemon of ssh each, of which one is cut off half-way
#   slurm     a cluster of one node
# The folder alone compiles the package anew, which takes a minute or two.  What is missing is installed, on
# Debian; disk, hosts and slurm need root, and are passed over without.  Last line: "N passed, N failed".  Variables: as
# for run_maxima.sh.
set -u
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=$(mktemp -d) || exit 1
passed=0
failed=0
MAXIMA_OBJDIR=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/objects
export MAXIMA_OBJDIR

end_all() {
  for file in "$work"/*.pid; do [ -e "$file" ] && kill -9 "$(cat "$file")" 2> /dev/null; done
  for name in 1 2; do
    ip netns pids "anmech$name" 2> /dev/null | xargs -r kill -9
    ip netns del "anmech$name" 2> /dev/null
  done
  umount "$work/disk/chunks" 2> /dev/null
  rm -rf "$work"
}
trap end_all EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

cat > "$work/problem.mac" << END
load("$root/share/anmech/anmech.mac")\$
coordinates([x])\$
spring : lagrange_system(diff(x,t)^2/2 - k*x^2/2, [x])\$
take([more]) := apply(sweep, append([spring, [x = 1], [0, 5], [[diff(x,t), 0, 1, 6], [k, -1, 4, 10]]], more))\$
flow : ode_system([-k*x], [x])\$
much([more]) := apply(sweep, append([flow, [], [0, 1/10], [[x, 1, 2, 200], [k, 1, 2, 150]], 'verify = false], more))\$
END

# Statements after those of the problem.
maxima_does() {
  TIMEOUT=${TIMEOUT:-900} "$here/run_maxima.sh" --very-quiet \
    --run-string="load(\"$work/problem.mac\")\$ $1 quit()\$" >> "$work/log" 2>&1
}

# Whether the table in the folder $1 is the one of the file $2.
same_table() {
  rm -f "$work/found.csv"
  maxima_does "sweep_save(sweep_read(\"$1\"), \"$work/found.csv\")\$"
  cmp -s "$work/found.csv" "$work/$2" && [ -z "$(ls "$1/chunks" | grep part)" ]
}

told() {
  if [ "$2" = 0 ]; then passed=$((passed + 1)); echo "$1: passed"
  else failed=$((failed + 1)); echo "$1: failed"; tail -n 15 "$work/log"; fi
}

command_of_maxima() {
  maxima_does "anmech_need(\"session/processes.lisp\")\$
    with_stdout(\"$work/command\", print(anmech_maxima_command()))\$"
  sed 's/ *$//' "$work/command"
}

# The folder $1 with the job, and no chunk yet.
new_folder() {
  maxima_does "take('folder = \"$1\", 'chunk = 5, 'engine = 'session)\$"
  rm -f "$1"/chunks/*
}

test_workers() {
  for pair in 1:30 2:9 5:12; do
    maxima_does "take('folder = \"$work/workers${pair%:*}\", 'chunk = ${pair#*:}, 'workers = ${pair%:*})\$"
    same_table "$work/workers${pair%:*}" small.csv
    told "workers: ${pair%:*}" $?
  done
  printf '# this machine\n\n1/:\n' > "$work/here"
  maxima_does "take('folder = \"$work/on hosts\", 'chunk = 30, 'hosts = \"$work/here\")\$"
  same_table "$work/on hosts" small.csv
  told "workers: of a list of hosts" $?
  # To workers nothing has been declared, and of initial values they have expressions.
  maxima_does "turn : lambda([v], motion_value(integrate_motion(spring, [x = 1, diff(x,t) = 0], [0, 1],
                                                                parameters = [k = v]), 1, x))\$
    map_of([more]) := sweep_table(apply(sweep_map, append([turn, [1, 4, 9]], more)))\$
    on_energy([more]) := sweep_table(apply(sweep, append([spring, [diff(x,t) = sqrt(2*E - k*x^2)], [0, 5],
      [[x, 0, 1, 4], k = [1, 4], E = [1/2, 1]]], more)))\$
    with_stdout(\"$work/declared.txt\", print(
      is(map_of() = map_of('folder = \"$work/declared\", 'workers = 2)), map(last, map_of()),
      is(on_energy() = on_energy('folder = \"$work/on energy\", 'workers = 2, 'chunk = 3))))\$"
  grep -q 'true *\[complete, complete, complete\] *true' "$work/declared.txt"
  told "workers: declared coordinates, initial values that depend on the grid" $?
}

# The factors are primes of 40 digits, for which Maxima would search all day.
test_limits() {
  maxima_does "p : next_prime(10^39)\$ q : next_prime(2*10^39)\$
    s : sweep_map(lambda([n], factor(n)), [6, p*q, 35], 'limit = 2, 'folder = \"$work/limits\", 'workers = 2)\$
    with_stdout(\"$work/limits.txt\", print(map(last, sweep_table(s))))\$"
  grep -q 'complete, *given up after 2 seconds, *complete' "$work/limits.txt"
  told "a case that does not stop" $?
}

test_sessions() {
  for signal in INT TERM HUP KILL; do
    place=$work/session$signal
    maxima_does "take('folder = \"$place\", 'chunk = 1, 'workers = 2)\$" &
    for second in $(seq 600); do
      [ "$(ls "$place/chunks" 2> /dev/null | wc -l)" -lt 2 ] || break
      sleep 0.1
    done
    # HOST.PROCESS.NUMBER
    session=$(ls "$place" | sed -n 's/^workers\.part-[^.]*\.\([0-9]*\)\..*\.process$/\1/p')
    kill -$signal "$session"
    wait $!
    flock -w 5 "$place/at_work" true && count=$(ls "$place/chunks" | wc -l) && [ "$count" -lt 60 ] && sleep 3 &&
      [ "$(ls "$place/chunks" | wc -l)" = "$count" ] && [ -z "$(pgrep -f "sweeps/jobs.*$place")" ]
    told "the session meets SIG$signal" $?
  done
  maxima_does "sweep_resume(\"$place\", 'workers = 2)\$"
  same_table "$place" small.csv
  told "goes on after that" $?
}

test_kills() {
  new_folder "$work/kills"
  command=$(command_of_maxima)
  start=$(date +%s.%N)
  ANMECH_HOME=$root MAXIMA=$command sh "$work/kills/run_chunk" 1 2 >> "$work/log" 2>&1
  usual=$(echo "$start $(date +%s.%N)" | awk '{ print $2 - $1 }')
  round=0
  while [ $round -lt 20 ]; do
    ANMECH_HOME=$root MAXIMA=$command setsid sh "$work/kills/run_all" 2 > /dev/null 2>&1 &
    # As long as a worker takes, or half again as long: most of them are met where they start, compute, write or end.
    sleep "$(awk -v seed="$round$$" -v usual="$usual" 'BEGIN { srand(seed); print usual * (0.1 + 1.4 * rand()) }')"
    kill -9 -- -$! 2> /dev/null
    for process in $(pgrep -f "sweeps/jobs.*$work/kills"); do kill -9 "$process" 2> /dev/null; done
    wait $! 2> /dev/null
    round=$((round + 1))
    # So that there is something left to be killed.
    [ "$(ls "$work/kills/chunks" | grep -vc part)" -lt 10 ] || rm -f "$work"/kills/chunks/*[13579]
  done
  ls "$work/kills/chunks" >> "$work/log"
  maxima_does "sweep_resume(\"$work/kills\", 'workers = 2)\$"
  same_table "$work/kills" small.csv
  told "killed 20 times" $?
}

test_disk() {
  [ "$(id -u)" = 0 ] || { echo "disk: passed over, needs root"; return; }
  maxima_does "sweep_save(much(), \"$work/large.csv\")\$"
  mkdir -p "$work/disk/chunks"
  mount -t tmpfs -o size=1m tmpfs "$work/disk/chunks" ||
    { echo "disk: passed over, no file system can be mounted"; return; }
  maxima_does "much('folder = \"$work/disk\", 'chunk = 1500, 'engine = 'session)\$"
  grep -q "is the disk full" "$work/log" && ! same_table "$work/disk" large.csv
  told "a full disk is told" $?
  maxima_does "sweep_save(much(), \"$work/disk/chunks/large.csv\")\$"
  [ -z "$(ls "$work/disk/chunks" | grep csv)" ]
  told "no half table on a full disk" $?
  maxima_does "sweep_resume(\"$work/disk\")\$"
  mount -o remount,size=16m "$work/disk/chunks"
  maxima_does "sweep_resume(\"$work/disk\")\$"
  same_table "$work/disk" large.csv
  told "a full disk, and then room" $?
}

test_folder() {
  new_folder "$work/alone"
  mkdir "$work/far away"
  mv "$work/alone" "$work/far away/sweep"
  command=$(command_of_maxima)
  MAXIMA=$command XDG_CACHE_HOME=$work/cache MAXIMA_OBJDIR=$work/objects \
    sh "$work/far away/sweep/run_all" 2 >> "$work/log" 2>&1
  same_table "$work/far away/sweep" small.csv
  told "the folder alone" $?
}

test_hosts() {
  [ "$(id -u)" = 0 ] || { echo "hosts: passed over, needs root"; return; }
  ssh-keygen -q -t ed25519 -N '' -f "$work/key"
  cp "$work/key.pub" "$work/keys"
  chmod 600 "$work/keys"
  mkdir -p /run/sshd
  # What a host of its own would find in its cache.
  printf 'SetEnv "MAXIMA=%s" ANMECH_HOME=%s MAXIMA_OBJDIR=%s\n' "$(command_of_maxima)" "$root" "$MAXIMA_OBJDIR" \
    > "$work/sshd_config"
  : > "$work/hosts"
  for name in 1 2; do
    ip netns add "anmech$name" && ip link add "anmech$name" type veth peer name inside netns "anmech$name" ||
      { echo "hosts: passed over, no network namespaces can be made here"; return; }
    ip addr add "10.199.$name.1/24" dev "anmech$name"
    ip link set "anmech$name" up
    ip -n "anmech$name" addr add "10.199.$name.2/24" dev inside
    ip -n "anmech$name" link set inside up
    ip -n "anmech$name" link set lo up
    ip netns exec "anmech$name" /usr/sbin/sshd -f "$work/sshd_config" -h "$work/key" \
      -o "ListenAddress=10.199.$name.2:2022" \
      -o "AuthorizedKeysFile=$work/keys" -o StrictModes=no -o "PidFile=$work/sshd$name.pid" -o UsePAM=no \
      >> "$work/log" 2>&1
    echo "1/ssh -F $work/ssh_config host$name" >> "$work/hosts"
    printf 'Host host%s\n  HostName 10.199.%s.2\n' $name $name >> "$work/ssh_config"
  done
  cat >> "$work/ssh_config" << END
Host *
  Port 2022
  User root
  IdentityFile $work/key
  StrictHostKeyChecking no
  UserKnownHostsFile /dev/null
  LogLevel ERROR
  BatchMode yes
  ConnectTimeout 5
  ServerAliveInterval 3
  ServerAliveCountMax 2
END
  maxima_does "take('folder = \"$work/far\", 'chunk = 4, 'hosts = \"$work/hosts\")\$" &
  session=$!
  for second in $(seq 600); do
    [ "$(ls "$work/far/chunks" 2> /dev/null | wc -l)" -lt 3 ] || break
    sleep 1
  done
  ip -n anmech2 link set inside down
  wait $session
  cat "$work/far/errors" >> "$work/log"
  told "chunks of two hosts, before one is cut off" "$([ "$(ls "$work/far/chunks" | wc -l)" -ge 3 ]; echo $?)"
  same_table "$work/far" small.csv || maxima_does "sweep_resume(\"$work/far\", 'workers = 2)\$"
  same_table "$work/far" small.csv
  told "a host that is cut off" $?
}

test_slurm() {
  [ "$(id -u)" = 0 ] || { echo "slurm: passed over, needs root"; return; }
  mkdir -p "$work/slurm" /run/munge /etc/munge
  [ -e /etc/munge/munge.key ] || { dd if=/dev/urandom of=/etc/munge/munge.key bs=128 count=1 2> /dev/null
                                   chown munge: /etc/munge/munge.key; chmod 400 /etc/munge/munge.key; }
  chown munge: /run/munge /etc/munge /var/log/munge /var/lib/munge 2> /dev/null
  pgrep -x munged > /dev/null || su -s /bin/sh munge -c /usr/sbin/munged >> "$work/log" 2>&1
  cat > "$work/slurm/slurm.conf" << END
ClusterName=anmech
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
StateSaveLocation=$work/slurm/state
SlurmdSpoolDir=$work/slurm/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurm/slurmctld.log
SlurmdLogFile=$work/slurm/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
NodeName=$(hostname -s) NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
  mkdir -p "$work/slurm/state" "$work/slurm/spool"
  SLURM_CONF=$work/slurm/slurm.conf
  ANMECH_HOME=$root
  export SLURM_CONF ANMECH_HOME
  slurmctld >> "$work/log" 2>&1
  slurmd >> "$work/log" 2>&1
  for second in $(seq 30); do sinfo -h 2> /dev/null | grep -q idle && break; sleep 1; done
  sinfo >> "$work/log" 2>&1
  sinfo -h 2> /dev/null | grep -q idle ||
    { echo "slurm: passed over, it does not start here"; tail -n 5 "$work/slurm/"*.log; return; }
  maxima_does "take('folder = \"$work/cluster\", 'chunk = 10, 'engine = 'slurm)\$"
  for second in $(seq 600); do
    [ "$(ls "$work/cluster/chunks" 2> /dev/null | grep -vc part)" -lt 6 ] || break
    sleep 1
  done
  cat "$work/cluster/errors" "$work/slurm/slurmctld.log" >> "$work/log"
  same_table "$work/cluster" small.csv
  told "Slurm" $?
  unset SLURM_CONF ANMECH_HOME
}

missing=
for pair in parallel:parallel rsync:rsync ssh:openssh-client sshd:openssh-server ip:iproute2 sbatch:slurm-wlm \
  munged:munge; do
  command -v "${pair%%:*}" > /dev/null || [ -x "/usr/sbin/${pair%%:*}" ] || missing="$missing ${pair#*:}"
done
[ -z "$missing" ] || "$here/install_packages.sh" $missing || exit 1

maxima_does "sweep_save(take(), \"$work/small.csv\")\$"
[ "$(wc -l < "$work/small.csv")" = 61 ] ||
  { echo "the session computes no sweep:"; tail -n 20 "$work/log"; echo "0 passed, 1 failed"; exit 1; }
for name in ${*:-workers limits sessions kills disk folder hosts slurm}; do "test_$name"; done
echo "$passed passed, $failed failed"
[ $failed = 0 ]
