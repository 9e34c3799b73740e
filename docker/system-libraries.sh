#!/bin/sh
# Install the Debian packages that boxlift's wheels need, or say in one line what to run, for `make setup`.
# The Dockerfile installs the same libraries. Usage: system-libraries.sh [PYTHON]
set -eu
python=${1:-python3}

missing=
need() { missing="$missing $1"; }
has_library() { "$python" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$1" 2>/dev/null; }

# What Open3D's wheel links against and does not carry.
has_library libusb-1.0.so.0 || need libusb-1.0-0
has_library libGL.so.1 || need libgl1
has_library libEGL.so.1 || need libegl1
has_library libgomp.so.1 || need libgomp1
has_library libX11.so.6 || need libx11-6
# Debian ships Python without the means to make a virtual environment.
"$python" -c 'import ensurepip, venv' 2>/dev/null || need "python3-venv"

[ -n "$missing" ] || exit 0
if [ "$(id -u)" = 0 ]; then
    as_root=
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root=sudo
else
    echo "boxlift needs system packages; run this and try again: sudo apt-get install -y$missing" >&2
    exit 1
fi
if ! command -v apt-get >/dev/null; then
    echo "boxlift needs these libraries, here under their Debian names; install them and try again:$missing" >&2
    exit 1
fi
echo "Installing system packages:$missing"
$as_root apt-get update -qq
# shellcheck disable=SC2086  # a list of package names
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null
