#!/bin/sh
# A suite as an array of Slurm jobs, one shard each. Submit it in a folder that all nodes share:
#
#   sbatch --array=0-7 slurm.sh tasks/suites/robustness.toml results 8
#   opspace merge results --json robustness.json        # when the queue is empty
#
# A job that ends early is requeued by Slurm, and continues its shard. To repeat one by hand: --array=5, with the same 8.
#SBATCH --cpus-per-task=2
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=slurm-%A_%a.txt
set -eu
# exec: opspace receives the signals of Slurm itself, and stops its runs safely.
exec "${OPSPACE:-opspace}" bench "$1" --shard "auto/$3" --out "$2" --jobs "${SLURM_CPUS_PER_TASK:-1}"
