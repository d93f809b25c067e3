#!/usr/bin/env bash
# A run on a cluster under Slurm that outlives the time limit of a job: it stops before the limit, and goes on in the next.
#   sbatch scripts/packaging/job.sh SCENE RUN [more words of fracflow run]
# FRACFLOW_ENV is a file to be sourced, with the modules or the environment of this cluster; FRACFLOW_LAUNCH starts
# ranks, "srun" by default, or "mpirun" where MPI was built without Slurm's PMI.
#SBATCH --job-name=fracflow
#SBATCH --ntasks=8
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=4G
#SBATCH --time=12:00:00
#SBATCH --signal=B:USR2@300
#SBATCH --requeue
#SBATCH --open-mode=append

if [ $# -lt 2 ]; then
  echo "usage: sbatch job.sh SCENE RUN [more words of fracflow run]" >&2
  exit 2
fi
scene=$1 run=$2
shift 2
export OMP_NUM_THREADS=1
if [ -n "${FRACFLOW_ENV:-}" ]; then
  # shellcheck disable=SC1090
  . "$FRACFLOW_ENV" || exit 2
fi
set -u

if [ -f "$run/checkpoint.h5" ]; then
  words=(resume "$run")
else
  words=(run "$scene" -o "$run" "$@")
fi

# Slurm sends USR2 to this shell alone, five minutes before the limit. The launcher passes it on to all ranks: they save
# their state after the step that they are in, and end with exit code 130.
at_limit=no
# shellcheck disable=SC2317
on_limit() {
  at_limit=yes
  kill -USR2 "$launcher"
}
# shellcheck disable=SC2086
${FRACFLOW_LAUNCH:-srun} fracflow "${words[@]}" </dev/null &
launcher=$!
trap on_limit USR2
wait "$launcher"
code=$?
if [ $at_limit = yes ]; then # the signal has ended wait, and the run goes on to the end of its step
  wait "$launcher"
  code=$?
fi

case $code in
0) ;;
2 | 3) ;; # bad input, a failed solve or a full disk: the next job would end alike
*)
  if [ $at_limit = yes ]; then
    echo "job.sh: the time limit came, exit code $code; the run goes on in the next job"
    scontrol requeue "$SLURM_JOB_ID" && exit 0
  fi
  ;;
esac
exit "$code"
