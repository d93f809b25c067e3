# Source this: everything fracflow needs on Debian or Ubuntu, made once, then the environment to run in.
#   . scripts/setup.sh
#   FRACFLOW_TESTS=yes . scripts/setup.sh       what the tests need too, as scripts/test does
# System packages come from apt, the rest from pip into .venv beside this folder; nothing else is touched.

_fracflow_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
_fracflow_packages="python3 python3-venv python3-petsc4py python3-mpi4py python3-h5py python3-h5py-mpi python3-scipy
  python3-numpy python3-gmsh openmpi-bin"
_fracflow_test_packages="chromium fonts-dejavu-core"

_fracflow_missing() {
  local package packages=$_fracflow_packages
  # for the loops of explicit steps; where nobody may install it, PETSc takes their place
  [ "$(id -u)" != 0 ] || command -v cc gcc >/dev/null || packages="$packages gcc libc6-dev"
  [ -z "${FRACFLOW_TESTS:-}" ] || packages="$packages $_fracflow_test_packages"
  for package in $packages; do
    # another Chromium serves too: Ubuntu has none among its packages
    [ "$package" = chromium ] && command -v chromium chromium-browser google-chrome >/dev/null && continue
    [ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || printf '%s ' "$package"
  done
}

# Runs a command as the only one for this folder: of two setups side by side the second waits for the first.
_fracflow_alone() {
  command -v flock >/dev/null || { "$@"; return; }
  (
    flock -n 9 || { echo "setup: waiting for another setup of $_fracflow_root"; flock 9; }
    "$@" 9>&-
  ) 9>"$_fracflow_root/.venv.lock"
}

_fracflow_install_system() {
  [ -z "$(_fracflow_missing)" ] || _fracflow_alone _fracflow_install_packages
}

_fracflow_install_packages() {
  local missing sudo=""
  missing=$(_fracflow_missing)
  missing=${missing% }
  [ -n "$missing" ] || return 0 # another setup has installed it meanwhile
  if [ "$(id -u)" != 0 ]; then
    if sudo -n true 2>/dev/null; then
      sudo="sudo -n"
    else
      echo "setup: missing packages; run: sudo apt-get update && sudo apt-get install -y --no-install-recommends $missing" >&2
      return 1
    fi
  fi
  echo "setup: installing $missing"
  # shellcheck disable=SC2086
  $sudo apt-get update -q </dev/null &&
    $sudo env DEBIAN_FRONTEND=noninteractive \
      apt-get install -y -q --no-install-recommends $missing </dev/null && return 0
  echo "setup: apt-get could not install: $missing" >&2
  return 1
}

_fracflow_stamp() {
  (cd "$_fracflow_root" && { cat scripts/constraints.txt ${1:-} scripts/setup.sh pyproject.toml \
    fracflow/laws/*.[ch] fracflow/solve/leapfrog/*.[ch]
    pwd; /usr/bin/python3 --version; dpkg-query -W -f '${Version}\n' python3-numpy; } | sha256sum | cut -d' ' -f1)
}

_fracflow_is_ready() {
  [ "$(cat "$_fracflow_root/.venv/$1" 2>/dev/null)" = "$2" ]
}

_fracflow_install_python() {
  local stamp tests="" file=.fracflow-stamp
  [ -z "${FRACFLOW_TESTS:-}" ] || { tests=scripts/constraints-test.txt; file=.fracflow-stamp-tests; }
  stamp=$(_fracflow_stamp $tests)
  _fracflow_is_ready $file "$stamp" || _fracflow_alone _fracflow_fill_venv $file "$stamp" $tests
}

_fracflow_fill_venv() {
  _fracflow_is_ready "$1" "$2" && return 0 # another setup has made it meanwhile
  echo "setup: preparing $_fracflow_root/.venv"
  _fracflow_make_venv "$@"
}

_fracflow_make_venv() {
  local venv=$_fracflow_root/.venv file=$1 stamp=$2 tests=${3:-} pin system
  # The system's own Python by its full path: its petsc4py works with no other.
  local clear=--clear
  grep -qs '^home = /usr/bin$' "$venv/pyvenv.cfg" && clear=""
  /usr/bin/python3 -m venv $clear --system-site-packages "$venv" || return 1
  system=$(/usr/bin/python3 -c 'import numpy, scipy; print(f"numpy=={numpy.__version__}\nscipy=={scipy.__version__}")') || return 1
  pin=$(mktemp) || return 1
  { cat "$_fracflow_root/scripts/constraints.txt"; echo "$system"; } >"$pin"
  "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-input --no-warn-conflicts \
    -r "$_fracflow_root/scripts/constraints.txt" ${tests:+-r "$_fracflow_root/$tests"} -c "$pin" </dev/null &&
    "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-input \
      --no-deps --no-build-isolation -e "$_fracflow_root" </dev/null
  local status=$?
  rm -f "$pin"
  [ $status = 0 ] || { echo "setup: pip could not fill $venv" >&2; return 1; }
  "$venv/bin/python" -c 'from fracflow._petsc import PETSc; import scipy, gmsh; from h5py import File' ||
    { echo "setup: the packages in $venv do not import together" >&2; return 1; }
  echo "$stamp" >"$venv/$file"
  [ -z "$tests" ] || _fracflow_stamp >"$venv/.fracflow-stamp"
}

_fracflow_petsc_dir() {
  local package
  for package in $(dpkg-query -W -f '${Package}\n' 'python3-petsc4py-real[0-9]*' 2>/dev/null | sort -rV); do
    dpkg -L "$package" | sed -n 's,^\(.*/petscdir/petsc[^/]*/[^/]*-real\)/lib/python3/dist-packages/petsc4py$,\1,p'
  done | sed -n 1p
}

export PYTHONNOUSERSITE=1 # packages in ~/.local would come before the system's numpy
export OMP_NUM_THREADS=1 MPLBACKEND=Agg
# ranks that wait leave the cores to others, and each takes the core that is free: bound to one that another process has, a rank
# that leaves it gets it back late
export OMPI_MCA_mpi_yield_when_idle=1 OMPI_MCA_hwloc_base_binding_policy=none
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
unset PYTHONHOME

if ! _fracflow_install_system; then return 1 2>/dev/null || exit 1; fi
if [ -z "${PETSC_DIR:-}" ]; then
  PETSC_DIR=$(_fracflow_petsc_dir)
  export PETSC_DIR
  [ -n "$PETSC_DIR" ] || unset PETSC_DIR
fi
if ! _fracflow_install_python; then return 1 2>/dev/null || exit 1; fi
export PATH="$_fracflow_root/.venv/bin:$PATH"
