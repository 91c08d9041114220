#!/usr/bin/env bash
# Makes this checkout ready to build: checks the tools, fills .venv and native/lib.
#
#   scripts/setup.sh build    what `cargo build` needs (make demo)
#   scripts/setup.sh test     that, and what `make test` needs
#   scripts/setup.sh gl       only OSMesa, which draws pictures, into native/gl: for machines on which
#                             apt cannot install it
#
# Everything lands inside the checkout, except Debian packages (apt, only as root or with sudo)
# and cargo-nextest (cargo's own bin folder). Nothing that is already there is fetched again.
set -euo pipefail
cd "$(dirname "$0")/.."

goal="${1:-build}"
case "$goal" in
  build | test | gl) ;;
  *)
    echo "setup.sh: unknown goal '$goal'; expected 'build', 'test' or 'gl'" >&2
    exit 64
    ;;
esac

say() { printf 'setup: %s\n' "$*" >&2; }
die() {
  printf 'setup: error: %s\n' "$*" >&2
  exit 1
}

# --- OSMesa without root ---------------------------------------------------------------------
# Unpacks Debian's packages instead of installing them. The server looks into native/gl when the
# system has no OSMesa.
fetch_osmesa() {
  local folder packages
  folder=$(mktemp -d)
  # What OSMesa needs beyond the C library, as far as it is packaged.
  packages=$(apt-cache depends --recurse --no-recommends --no-suggests --no-conflicts --no-breaks \
    --no-replaces --no-enhances --no-pre-depends libosmesa6 2>/dev/null |
    grep -E '^lib' | grep -vE '^(libc6|libgcc-s1|libcrypt1|libstdc\+\+6)' | sort -u)
  [ -n "$packages" ] || { rm -rf "$folder"; return 1; }
  # shellcheck disable=SC2086 # a list of names
  (cd "$folder" && apt-get download -qq $packages) >/dev/null 2>&1 || { rm -rf "$folder"; return 1; }
  mkdir -p native/gl
  for package in "$folder"/*.deb; do
    dpkg -x "$package" "$folder/root"
  done
  find "$folder/root" -name 'lib*.so.*' -exec cp -a {} native/gl/ \;
  rm -rf "$folder"
  ls native/gl/libOSMesa.so.* >/dev/null 2>&1
}
if [ "$goal" = gl ]; then
  fetch_osmesa || die "apt cannot fetch libosmesa6 (Mesa 25.1 and newer have none): install libegl1 and libegl-mesa0 instead"
  say "ready (gl)"
  exit
fi

# --- Debian packages -------------------------------------------------------------------------
missing=()
command -v cc >/dev/null && command -v c++ >/dev/null && command -v make >/dev/null || missing+=(build-essential)
command -v python3 >/dev/null || missing+=(python3)
python3 -c 'import venv, ensurepip' 2>/dev/null || missing+=(python3-venv)
if [ ${#missing[@]} -gt 0 ]; then
  if [ "$(id -u)" = 0 ]; then
    as_root=()
  elif sudo -n true 2>/dev/null; then
    as_root=(sudo)
  else
    die "these Debian packages are missing: ${missing[*]}
       with root:    apt-get install ${missing[*]}
       without root: put a C/C++ compiler, make and a python3 >= 3.11 that has the venv module
       (conda, pyenv and the like all work) on the PATH, then run this again"
  fi
  say "installing ${missing[*]} with apt"
  "${as_root[@]}" apt-get update -qq
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${missing[@]}" >/dev/null
fi

# OpenGL for pictures, drawn by the processor. All but pictures works without, so failing here is
# no error; Mesa 25.1 and newer have EGL only.
has_library() { ldconfig -p 2>/dev/null | grep -qE "$1"; }
apt_install() {
  local as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo -n)
  { "${as_root[@]}" apt-get install -y -qq "$@" ||
    { "${as_root[@]}" apt-get update -qq && "${as_root[@]}" apt-get install -y -qq "$@"; }; } >/dev/null 2>&1
}
if ! has_library 'libOSMesa\.so\.[68]' && ! ls native/gl/libOSMesa.so.* >/dev/null 2>&1; then
  say "installing OSMesa, which draws pictures"
  export DEBIAN_FRONTEND=noninteractive
  apt_install libosmesa6 || fetch_osmesa || has_library 'libEGL_mesa\.so\.0' || apt_install libegl1 libegl-mesa0 ||
    say "warning: no OpenGL to draw with; everything but pictures works (apt-get install libosmesa6)"
fi

# --- Versions --------------------------------------------------------------------------------
command -v cargo >/dev/null || die "cargo is not on the PATH; install Rust >= 1.95 (rustup does)"
rust_minor=$(rustc --version | sed -E 's/^rustc 1\.([0-9]+).*/\1/')
[ "$rust_minor" -ge 95 ] || die "$(rustc --version) is too old; Rust >= 1.95 is needed (rustup update stable)"
python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  die "$(python3 --version) is too old; Python >= 3.11 is needed"

# --- Python packages -------------------------------------------------------------------------
[ -x .venv/bin/python ] || {
  say "creating .venv"
  python3 -m venv .venv
}
install_requirements() { # name of a file in requirements/
  local stamp=.venv/.installed-$1
  local wanted
  wanted=$(cat requirements/*.txt | sha256sum)
  if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    say "installing requirements/$1.txt into .venv"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -r "requirements/$1.txt"
    printf '%s\n' "$wanted" >"$stamp"
  fi
}
install_requirements build
[ "$goal" = build ] || install_requirements dev

# --- libmujoco and ONNX Runtime ---------------------------------------------------------------
# Both shared libraries travel inside Python wheels. The cp312 tag only picks the wheel: the
# libraries do not depend on the local Python.
mujoco_version=3.17.0
ort_version=1.31.1
if [ ! -e "native/lib/libmujoco.so.$mujoco_version" ] || [ ! -e "native/lib/libonnxruntime.so.$ort_version" ]; then
  machine=$(uname -m)
  case "$machine" in
    x86_64 | aarch64) ;;
    *) die "no libmujoco for machine type '$machine'; expected x86_64 or aarch64" ;;
  esac
  say "fetching libmujoco $mujoco_version and ONNX Runtime $ort_version"
  wheels=$(mktemp -d)
  trap 'rm -rf "$wheels"' EXIT
  .venv/bin/python -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
    --python-version 3.12 --implementation cp --abi cp312 \
    --platform "manylinux_2_28_$machine" --platform "manylinux_2_27_$machine" \
    -d "$wheels" "mujoco==$mujoco_version" "onnxruntime==$ort_version"
  .venv/bin/python scripts/unpack_native.py native/lib "$wheels"/*.whl
fi

# --- Node.js example -------------------------------------------------------------------------
if [ "$goal" = test ]; then
  node_major=$(node --version 2>/dev/null | sed -E 's/^v([0-9]+).*/\1/' || true)
  node_path=$PATH
  if [ "${node_major:-0}" -lt 20 ] || ! command -v npm >/dev/null; then
    # requirements/dev.txt has one.
    node_path=$PWD/.venv/bin:$PATH
  fi
  stamp=examples/node/node_modules/.installed
  wanted=$(sha256sum <examples/node/package.json)
  if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    say "installing the packages of examples/node"
    PATH=$node_path npm install --prefix examples/node --no-package-lock --no-audit --no-fund --ignore-scripts --loglevel=error >/dev/null ||
      die "npm cannot install the packages of examples/node; it needs Node.js >= 20 ($(PATH=$node_path command -v node)) and a registry"
    printf '%s\n' "$wanted" >"$stamp"
  fi
fi

# --- Test runner -----------------------------------------------------------------------------
if [ "$goal" = test ] && ! cargo nextest --version >/dev/null 2>&1; then
  say "building cargo-nextest (once, a few minutes)"
  cargo install --quiet --locked cargo-nextest --version 0.9.143
fi
say "ready ($goal)"
