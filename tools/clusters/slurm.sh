#!/bin/bash
# Runs the recipe of docs/guides/clusters.md on a Slurm of one machine: an array of four jobs makes a dataset, one of them is cancelled by a signal on the
# way and requeued, a last job merges the parts, and the result has the bytes of one run.
#
#     sudo tools/clusters/slurm.sh path/to/srflow FOLDER
set -euo pipefail
source "$(dirname "$0")/one_machine.sh"

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
