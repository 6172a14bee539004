#!/bin/bash
# Runs the recipe of docs/clusters.md on a Slurm of one machine: an array of four jobs makes a dataset, one of them is cancelled by a signal on the
# way and requeued, a last job merges the parts, and the result has the bytes of one run.
#
#     apt-get install slurm-wlm munge
#     sudo tools/clusters/slurm.sh path/to/srflow FOLDER
#
# Starts munged, slurmctld and slurmd with files in FOLDER, and ends them.
set -euo pipefail
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

cat > part.sh <<JOB
#!/bin/bash
#SBATCH --array=1-4 --cpus-per-task=1 --requeue --signal=TERM@60
srun "$srflow" shapes --pairs 1600 --size 256x192 --seed 5 --out "$folder/part-\$SLURM_ARRAY_TASK_ID" --shard auto --json
code=\$?
# 75: stopped by a signal. The job engine runs it again, and it continues.
if [ \$code = 75 ]; then scontrol requeue "\${SLURM_ARRAY_JOB_ID}_\$SLURM_ARRAY_TASK_ID"; sleep 60; fi
exit \$code
JOB
cat > merge.sh <<JOB
#!/bin/bash
#SBATCH --cpus-per-task=1
"$srflow" merge $folder/part-* --out "$folder/shapes"
JOB
array=$(sbatch --parsable --output="$folder/logs/part-%a.log" --open-mode=append part.sh)
merge=$(sbatch --parsable --output="$folder/logs/merge.log" --dependency=afterok:"$array" merge.sh)
echo "array $array, merge $merge"

# The second task gets SIGTERM once it has made something.
until ls part-2/data/*_flow.npz16 > /dev/null 2>&1; do sleep 0.05; done
until scancel --signal=TERM "${array}_2"; do sleep 0.2; done
for _ in $(seq 600); do
    if [ -z "$(squeue --noheader --jobs "$array,$merge" 2>/dev/null)" ]; then break; fi
    sleep 1
done
for job in part-1 part-2 part-3 part-4 merge; do
    echo "== $job"
    cat "logs/$job.log"
done
grep -q '"error": "stopped by SIGTERM\|"stopped": true' logs/part-2.log
"$srflow" shapes --pairs 1600 --size 256x192 --seed 5 --out whole > /dev/null
diff -r whole shapes
(cd shapes && sha256sum --quiet --check SHA256SUMS)
echo "the merged dataset has the bytes of one run"
