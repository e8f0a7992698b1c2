#!/usr/bin/env bash
# slurm_here.sh DIR: starts a real Slurm with two nodes on this machine, to try `augnerf sweep slurm`. Debian's packages are
# downloaded and unpacked below DIR. Nothing is installed, and everything listens on 127.0.0.1 only.
#
#   tools/slurm_here.sh DIR && . DIR/env && sinfo      # sbatch, squeue, scancel, scontrol are on the PATH now
#   DIR/stop                                           # stops its daemons
set -euo pipefail
dir=$(realpath -m "${1:?usage: slurm_here.sh DIR}")
mkdir -p "$dir"/{packages,root,run,state,log,cgroup,spool/left,spool/right}

if [[ ! -x $dir/root/usr/sbin/slurmctld-wlm ]]; then
  (cd "$dir/packages" && apt-get download -qq \
    munge libmunge2 slurmctld slurmd slurm-client slurm-wlm-basic-plugins libhwloc15 liblua5.1-0)
  for package in "$dir"/packages/*.deb; do dpkg-deb -x "$package" "$dir/root"; done
fi
lib=$(dirname "$(find "$dir/root" -type d -name slurm-wlm -path '*/lib/*')")
sbin=$dir/root/usr/sbin

cat > "$dir/env" << EOF
export SLURM_CONF=$dir/slurm.conf LD_LIBRARY_PATH=$lib:$lib/slurm-wlm PATH=$dir/root/usr/bin:\$PATH
EOF
cat > "$dir/stop" << EOF
#!/bin/sh
for file in $dir/run/*.pid; do [ -s "\$file" ] && kill "\$(cat "\$file")" 2> /dev/null; done
true
EOF
chmod +x "$dir/stop"
. "$dir/env"

# Slurm runs as this user. Its credentials expire fast, so that a requeued task starts again within seconds.
me=$(id -un)
cat > "$dir/slurm.conf" << EOF
ClusterName=here
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmUser=$me
SlurmdUser=$me
SlurmctldPort=27817
AuthType=auth/munge
AuthInfo=socket=$dir/run/munge.socket,cred_expire=5
CredType=cred/munge
PluginDir=$lib/slurm-wlm
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
StateSaveLocation=$dir/state
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd-%n.pid
SlurmdSpoolDir=$dir/spool/%n
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=1,sched_interval=2
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
KillWait=30
ReturnToService=2
NodeName=left NodeHostname=$(hostname -s) NodeAddr=127.0.0.1 Port=27818 CPUs=2 RealMemory=2000
NodeName=right NodeHostname=$(hostname -s) NodeAddr=127.0.0.1 Port=27819 CPUs=2 RealMemory=2000
PartitionName=all Nodes=left,right Default=YES MaxTime=INFINITE State=UP
# Its jobs preempt others at once.
PartitionName=urgent Nodes=left,right PriorityTier=2 MaxTime=INFINITE State=UP
EOF
# A separate mount point keeps slurmd away from the control groups of this machine.
printf 'CgroupPlugin=cgroup/v1\nCgroupMountpoint=%s\n' "$dir/cgroup" > "$dir/cgroup.conf"

[[ -s $dir/munge.key ]] || (umask 077 && head -c 1024 /dev/urandom > "$dir/munge.key")
"$sbin/munged" --force --key-file="$dir/munge.key" --socket="$dir/run/munge.socket" --pid-file="$dir/run/munged.pid" \
  --log-file="$dir/log/munged" --seed-file="$dir/run/munge.seed"
# daemon NAME COMMAND...: runs a command in its own session, with its output in DIR/log.
daemon() { setsid "${@:2}" > "$dir/log/$1" 2>&1 < /dev/null & }
daemon slurmctld "$sbin/slurmctld-wlm" -D -c -f "$SLURM_CONF"
for node in left right; do
  daemon "$node" "$sbin/slurmd-wlm" -D -c -f "$SLURM_CONF" -N $node -d "$sbin/slurmstepd-wlm"
done
for ((i = 0; i < 60; i++)); do
  [[ $(sinfo -h -t idle -o %D 2> /dev/null) == 2 ]] && exit 0
  sleep 0.5
done
echo "Slurm did not start within 30 seconds; see $dir/log" >&2
exit 1
