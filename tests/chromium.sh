#!/bin/sh
# Install Debian's Chromium for the tests of the review page, or say in one line that they will be skipped.
set -eu
[ -x /usr/bin/chromium ] && exit 0
if [ "$(id -u)" = 0 ]; then
    as_root=
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root=sudo
else
    echo "The tests of the review page need a browser; to run them too: sudo apt-get install -y chromium" >&2
    exit 0
fi
command -v apt-get >/dev/null || exit 0
echo "Installing chromium for the tests of the review page"
{ $as_root apt-get update -qq &&
    DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq --no-install-recommends chromium; } >/dev/null ||
    echo "Chromium could not be installed; the tests of the review page are skipped" >&2
