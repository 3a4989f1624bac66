#!/bin/sh
# Starts or stops a single-node Slurm cluster on this machine, to test `make cluster PROFILE=slurm`.
# The script runs Debian's slurmctld and slurmd directly and keeps all their files in one folder.
# The only exception is a link to slurm.conf in /run/slurm/conf. Jobs that Snakemake's executor
# submits do not inherit SLURM_CONF, so Slurm looks for its configuration there. The script starts
# no system service and does not change /etc.
#
#   apt-get install --no-install-recommends slurm-wlm munge
#   tests/slurm.sh start FOLDER      as root
#   tests/slurm.sh stop FOLDER
set -eu

stop_with() {
    printf 'error: %s\n  why it matters: %s\n  what to do: %s\n' "$1" "$2" "$3" >&2
    exit 2
}

[ $# = 2 ] || stop_with "$*: not understood" "a Slurm for tests is started or stopped in a folder" "tests/slurm.sh start|stop FOLDER"
PATH=$PATH:/usr/sbin:/sbin
for program in munged slurmctld slurmd scontrol; do
    command -v "$program" >/dev/null || stop_with "$program: not found" "it is a part of Slurm" "apt-get install slurm-wlm munge"
done
mkdir -p "$2"
folder=$(cd "$2" && pwd)
link=/run/slurm/conf/slurm.conf

case $1 in
start)
    [ "$(id -u)" = 0 ] || stop_with "this is not root" "slurmd begins jobs as their users" "run it as root"
    for conf in /etc/slurm/slurm.conf /run/slurm/conf/slurm.conf; do
        [ ! -e "$conf" ] || stop_with "$conf: is there" "this machine has a Slurm, and two would be mixed up" "use that one, or stop it first"
    done
    mkdir -p "$folder/state" "$folder/spool"
    # munged requires a folder that only its owner can write to.
    mkdir -p "$folder/munge" && chmod 755 "$folder/munge"
    [ -f "$folder/munge.key" ] || (umask 077 && head -c 128 /dev/urandom >"$folder/munge.key")
    node=$(hostname -s)
    cores=$(nproc)
    memory=$(awk '/MemTotal/ { print int($2 / 1024) }' /proc/meminfo)
    cat >"$folder/slurm.conf" <<END
ClusterName=test
SlurmctldHost=$node(127.0.0.1)
SlurmUser=root
AuthInfo=socket=$folder/munge/socket
SlurmctldPort=16817
SlurmdPort=16818
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
# Slurm must remember finished jobs for as long as the executor may query them.
MinJobAge=600
NodeName=$node NodeAddr=127.0.0.1 CPUs=$cores RealMemory=$memory State=UNKNOWN
PartitionName=test Nodes=$node Default=YES MaxTime=INFINITE State=UP
END
    munged --force --key-file "$folder/munge.key" --socket "$folder/munge/socket" --pid-file "$folder/munge/pid" \
        --log-file "$folder/munge/log" --seed-file "$folder/munge/seed"
    mkdir -p /run/slurm/conf
    ln -s "$folder/slurm.conf" "$link"
    # The daemons read only this configuration file.
    export SLURM_CONF="$folder/slurm.conf"
    slurmctld
    slurmd -N "$node"
    for _ in 1 2 3 4 5 6 7 8 9 10; do
        if scontrol show node "$node" 2>/dev/null | grep -q 'State=IDLE'; then
            echo "$node: ready"
            exit 0
        fi
        sleep 1
    done
    stop_with "$node: not ready after ten seconds" "no job would be begun" "read $folder/slurmctld.log and $folder/slurmd.log"
    ;;
stop)
    for file in slurmd.pid slurmctld.pid munge/pid; do
        if [ -f "$folder/$file" ]; then kill "$(cat "$folder/$file")" || true; fi
    done
    if [ "$(readlink "$link")" = "$folder/slurm.conf" ]; then rm "$link"; fi
    ;;
*) stop_with "$1: neither start nor stop" "a Slurm for tests is started or stopped in a folder" "tests/slurm.sh start|stop FOLDER" ;;
esac
