#!/usr/bin/env bash
# Builds three.bundle.js anew, byte for byte: needs Node.js and the npm registry.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-audit --no-fund --save-exact three@0.187.0 esbuild@0.28.2
cp "$here/three_entry.js" entry.js
npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE --target=es2020 \
    --charset=ascii --legal-comments=inline --outfile="$here/three.bundle.js" \
    --banner:js='/*! three.js 0.187.0, MIT licence, Copyright 2010-2026 three.js authors */'
cp node_modules/three/LICENSE "$here/three.LICENSE.txt"
