#!/bin/bash
# Runs the recipe of docs/guides/clusters.md for training on several nodes on a Slurm of one machine: two ranks that srun starts, which get SIGTERM on the
# way and are requeued. The weights are those of one process that accumulates two parts.
#
#     apt-get install openmpi-bin
#     sudo tools/clusters/slurm_training.sh path/to/srflow FOLDER         # srflow built with --features mpi
set -euo pipefail
source "$(dirname "$0")/one_machine.sh"

"$srflow" shapes --pairs 24 --size 160x128 --seed 5 --out shapes > /dev/null
arguments=(--network raft-small --data chairs:shapes@all --crop 128x96 --batch 2 --iterations 2 --steps 60 --threads 1
    --set checkpoints.every=10)
cat > train.sh <<JOB
#!/bin/bash
#SBATCH --ntasks=2 --cpus-per-task=1 --requeue --signal=TERM@120
cd "$folder"
if [ -d run/checkpoints ]; then what="--resume run"; else what="--out run ${arguments[*]}"; fi
srun --mpi=pmix --kill-on-bad-exit=1 "$srflow" train --mpi \$what
code=\$?
# 75: stopped by a signal, with a checkpoint.
if [ \$code = 75 ]; then scontrol requeue "\$SLURM_JOB_ID"; sleep 60; fi
exit \$code
JOB
job=$(sbatch --parsable --output="$folder/logs/train.log" --open-mode=append train.sh)
echo "job $job"
until [ -d run/checkpoints/step-00000010 ]; do sleep 0.05; done
scancel --signal=TERM "$job"
for _ in $(seq 600); do
    if [ -z "$(squeue --noheader --jobs "$job" 2>/dev/null)" ]; then break; fi
    sleep 1
done
cat logs/train.log
grep -q 'Stopped on request' logs/train.log
"$srflow" train --out one "${arguments[@]}" --set training.accumulate=2 > /dev/null
cmp one/last.safetensors run/last.safetensors
echo "two ranks that were stopped on the way gave the bits of one process"
