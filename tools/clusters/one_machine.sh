# Sourced by the scripts beside: a Slurm of one machine, with its files in the folder $2, and $srflow, the program $1. It ends with the script.
#
#     apt-get install slurm-wlm munge
srflow=$(realpath "$1")
folder=$(realpath -m "$2")
mkdir -p "$folder"/{state,spool,munge,logs}
cd "$folder"
host=$(hostname -s)
cores=$(nproc)

chmod 700 munge
chown munge munge 2>/dev/null || true
dd if=/dev/urandom of=munge/key bs=1 count=1024 status=none
chmod 400 munge/key
chown munge munge/key 2>/dev/null || true

cat > slurm.conf <<CONF
ClusterName=one
SlurmctldHost=$host
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
CryptoType=crypto/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
SlurmctldPort=26817
SlurmdPort=26818
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MinJobAge=300
NodeName=$host NodeHostname=$host NodeAddr=127.0.0.1 CPUs=$cores State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$folder/slurm.conf

stop() {
    for name in slurmd slurmctld munged; do
        if [ -f "$folder/$name.pid" ]; then kill "$(cat "$folder/$name.pid")" 2>/dev/null || true; fi
    done
}
trap stop EXIT
munge_options=(--force --socket "$folder/munge/socket" --key-file "$folder/munge/key" --log-file "$folder/munge/log"
    --pid-file "$folder/munged.pid" --seed-file "$folder/munge/seed")
chmod 711 .
munged "${munge_options[@]}"
slurmctld
slurmd
for _ in $(seq 60); do
    if sinfo --noheader --format %t | grep -q idle; then break; fi
    sleep 1
done
sinfo
