#!/bin/sh
# Draws the figures of the README from the report of the demo. Needs chromium (or a Chrome under that name).
set -eu
cd "$(dirname "$0")/../.."
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cargo run --release --quiet -- demo --out "$dir" >/dev/null

# figure TITLE HEIGHT NAME: one figure of the report as it stands there, with its key.
figure() {
    {
        sed -n '1,/<main>/p' "$dir/report.html"
        awk -v title="<h3>$1</h3>" '
            /^<figure>/ { held = $0; next }
            held != "" { if ($0 == title) on = 1; if (on) print held; held = "" }
            on { print }
            /^<\/figure>/ { on = 0 }' "$dir/report.html"
    } >"$dir/figure.html"
    chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size="960,$2" \
        --screenshot="docs/figures/$3.png" "file://$dir/figure.html" 2>/dev/null
}
figure "Wheel–rail contact force" 640 forces
figure "Crossing irregularity" 665 irregularity
