#!/usr/bin/env bash
# Installs the peers and builds the harness; `make peers` calls it. It can be called again: up-to-date parts are skipped.
#
#   .venv-peers/                       the peers and example-robot-data, of the versions in requirements.txt
#   target/peers/models/               the models, and the URDF of each robot
#   target/peers/pinocchio_bench       the harness
#   target/peers/accelerations.csv     values that both programs must reproduce before their times are compared
#
# PYTHON=... selects the interpreter of the environment; the packages of the system are not changed.
set -euo pipefail
shopt -s inherit_errexit

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$here/../.." && pwd)
venv=$root/.venv-peers
out=$root/target/peers
eigen=/usr/include/eigen3
python=${PYTHON:-python3}

say() { echo "peers: $*" >&2; }
die() { say "$*"; exit 1; }

missing_packages() {
  command -v g++ >/dev/null || echo g++
  [[ -f $eigen/Eigen/Core ]] || echo libeigen3-dev
  if ! command -v "$python" >/dev/null; then
    echo python3 python3-venv
  elif ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    echo python3-venv # Debian splits it from python3
  fi
}

install_packages() {
  local wanted
  read -ra wanted <<<"$(missing_packages | tr '\n' ' ')"
  [[ ${#wanted[@]} -gt 0 ]] || return 0
  command -v apt-get >/dev/null || die "missing: ${wanted[*]} (names as in Debian), and there is no apt-get"
  [[ $EUID -eq 0 ]] || die "missing packages; install them and call again: sudo apt-get install ${wanted[*]}"
  say "installing ${wanted[*]} with apt-get"
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${wanted[@]}" >&2
  read -ra wanted <<<"$(missing_packages | tr '\n' ' ')"
  [[ ${#wanted[@]} -eq 0 ]] || die "still missing after apt-get: ${wanted[*]} (is PYTHON=$python a Debian Python?)"
}

refresh_venv() {
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || die "$("$python" --version) is too old: 3.11 or newer, for MuJoCo"
  local version='import sys; print(sys.version)'
  if [[ "$("$venv/bin/python" -c "$version" 2>/dev/null)" != "$("$python" -c "$version")" ]]; then
    say "creating $venv"
    "$python" -m venv --clear "$venv"
    echo '*' >"$venv/.gitignore"
  fi
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$here/requirements.txt"
}

# Flags: the definitions are those of Pinocchio's CMake target.
compile_flags=(-std=c++17 -O3 -DNDEBUG -march=native)
definitions=(
  -DBOOST_MPL_LIMIT_LIST_SIZE=30 -DBOOST_MPL_LIMIT_VECTOR_SIZE=30
  -DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS -DBOOST_FUSION_INVOKE_MAX_ARITY=12
)

# All dependencies of the harness; with -march=native the processor is one of them.
stamp() {
  echo "${compile_flags[*]} ${definitions[*]}"
  sha256sum <"$here/pinocchio_bench.cpp"
  grep -E '^(pin|libpinocchio|cmeel-boost)==' "$here/requirements.txt"
  g++ --version | head -n 1
  g++ -march=native -Q --help=target | sha256sum
  grep -h EIGEN_ "$eigen/Eigen/src/Core/util/Macros.h" | sha256sum
  echo "$venv"
  "$venv/bin/python" -VV
}

build() {
  local prefix
  prefix=$("$venv/bin/python" -c 'import pathlib, pinocchio; print(pathlib.Path(pinocchio.__file__).resolve().parents[4])')
  say "compiling the harness (about four minutes)"
  # -w: with AVX-512, g++ 12 prints thousands of lines of warnings about its own intrinsics, wherever Eigen is inlined.
  # For those about our file: the same command with -fsyntax-only -Wall -Wextra instead.
  g++ "${compile_flags[@]}" "${definitions[@]}" "-DCOMPILE_FLAGS=\"${compile_flags[*]}\"" -w \
    -isystem "$prefix/include" -isystem "$eigen" "$here/pinocchio_bench.cpp" -o "$out/pinocchio_bench" \
    -L"$prefix/lib" -lboost_serialization -Wl,-rpath,"$prefix/lib"
}

install_packages
refresh_venv
mkdir -p "$out"
current=$(stamp)
if [[ -x $out/pinocchio_bench && -f $out/stamp && $(<"$out/stamp") == "$current" ]]; then
  say "up to date: $out/pinocchio_bench"
else
  rm -f "$out/stamp" # written last, so that an interrupted build is repeated
  build
  echo "$current" >"$out/stamp"
  say "built $out/pinocchio_bench"
fi
# These take a second or two and are written every time.
"$venv/bin/python" "$here/dump_models.py" "$out/models"
"$out/pinocchio_bench" --accelerations "$out"/models/*.bin >"$out/accelerations.csv"
