#!/usr/bin/env bash
# Run once, as root, when the platform makes its container.
set -euo pipefail
cd "$(dirname "$0")/course"
if ! python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
  apt-get update
  apt-get install -y --no-install-recommends python3.11 python3.11-venv
fi
sh .ci/setup
